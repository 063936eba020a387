// Past runs: the list, and one opened, with its replay, its figures and its files.
import { paint } from "/rcmservo/picture.js";
import { rcm } from "/rcmservo/wire.js";

const AGAIN = 5000; // ms between looks at the list
const GREY = "#8a8a8a";

// What the server answers; what it refuses is an error with its words.
async function asked(path) {
  const answer = await fetch(rcm.url(path), { cache: "no-store" });
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({}));
  throw new Error(typeof told.detail === "string" ? told.detail : "the server cannot answer");
}

function blank([width, height]) {
  const sheet = new OffscreenCanvas(width, height), pen = sheet.getContext("2d");
  pen.fillStyle = GREY;
  pen.fillRect(0, 0, width, height);
  return sheet;
}

const Replay = {
  props: { path: String, told: Object },
  data: () => ({ at: 0, said: "", playing: null, busy: false }),
  computed: { last() { return this.told.moments.length - 1; } },
  mounted() { this.show(0); },
  unmounted() { clearTimeout(this.playing); },
  methods: {
    async show(i) {
      const { moments, spans } = this.told, [, , phase, why] = spans[moments[i].span] || [];
      this.at = i;
      this.said = `${moments[i].t.toFixed(2)} s · ${[phase, why].filter(Boolean).join(" · ")}`;
      if (this.busy) return;
      this.busy = true;
      try {
        for (let drawn = -1; drawn !== this.at;) { // the newest that is wanted, none between
          drawn = this.at;
          await this.draw(moments[drawn]);
        }
      } catch (error) {
        this.said = error.message;
      } finally {
        this.busy = false;
      }
    },
    async draw({ points, rcm: o_c, stage, picture }) {
      const image = picture < 0 ? blank(this.told.size)
        : await createImageBitmap(await (await asked(`${this.path}/pictures/${picture}`)).blob());
      if (this.$refs.canvas) {
        paint(this.$refs.canvas, image, { points, rcm: o_c, target: this.told.targets[stage] });
      }
      image.close?.();
    },
    turn() {
      clearTimeout(this.playing);
      if (this.playing !== null) { this.playing = null; return; }
      const { moments } = this.told;
      let i = this.at >= this.last ? 0 : this.at;
      const began = performance.now() - 1000 * moments[i].t;
      const step = () => {
        if (!this.$el.isConnected) { this.playing = null; return; }
        const t = (performance.now() - began) / 1000;
        while (i < this.last && moments[i + 1].t <= t) i += 1;
        if (i !== this.at) this.show(i);
        this.playing = i < this.last ? setTimeout(step, 50) : null;
      };
      step();
    },
  },
  template: `
    <div class="run-replay">
      <div class="run-banner">Replay of the past: the live picture is above</div>
      <canvas ref="canvas" role="img" aria-label="Picture of the past run"></canvas>
      <div class="run-head">
        <button type="button" class="rcm-button" @click="turn">
          {{ playing === null ? "Play" : "Hold still" }}</button>
        <input type="range" min="0" :max="last" step="1" :value="at" :aria-valuetext="said"
          aria-label="Time in the past run" @input="show(Number($event.target.value))">
      </div>
      <div class="run-said">{{ said }}</div>
    </div>`,
};

export default {
  components: { Replay },
  data: () => ({ runs: null, run: null, told: null, error: "" }),
  computed: {
    path() { return `/runs/${this.run.name}`; },
    summary() {
      const missing = this.told.missing ? [["missing", this.told.missing]] : [];
      return [...missing, ["verdict", this.told.verdict], ...this.told.summary];
    },
  },
  mounted() {
    this.list();
    setInterval(() => { if (this.$el.offsetParent && !this.run) this.list(); }, AGAIN);
  },
  methods: {
    url: rcm.url,
    async list() {
      try {
        this.runs = await (await asked("/runs")).json();
        if (!this.run) this.error = "";
      } catch (error) {
        if (!this.run) this.error = error.message;
      }
    },
    async open(run) {
      [this.run, this.told, this.error] = [run, null, ""];
      this.$nextTick(() => this.$refs.back.focus());
      const told = await asked(this.path).then((answer) => answer.json()).catch((error) => error);
      if (this.run !== run) return;
      if (told instanceof Error) this.error = told.message;
      else this.told = Object.freeze(told); // too much to be watched for changes
    },
    close() {
      [this.run, this.told, this.error] = [null, null, ""];
      this.list();
    },
    length(seconds) {
      if (seconds === null) return "";
      if (seconds < 60) return `${seconds.toFixed(1)} s`;
      return `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`;
    },
  },
  template: `
    <div class="w-full">
      <div v-if="run" class="run-head">
        <button type="button" class="rcm-button" ref="back" @click="close">
          Back to the list</button>
        <strong>Past run {{ run.folder }}, {{ run.when }}</strong>
      </div>
      <p v-if="run && !told && !error" role="status">The record is being read …</p>
      <div v-if="told || (run && error)" class="run-head">
        <a class="rcm-button" download="" :href="url(path + '/record.mcap')"
          >Download the record (MCAP)</a>
      </div>
      <p v-if="error" role="alert" class="run-alert">{{ error }}</p>
      <template v-if="told">
        <replay v-if="told.moments.length" :path="path" :told="told"></replay>
        <p v-else>The record holds no tick.</p>
        <table class="run-list" aria-label="Summary"><tbody>
          <tr v-for="[name, text] in summary"><th scope="row">{{ name }}</th><td>{{ text }}</td></tr>
        </tbody></table>
        <div class="run-lines"><table class="run-list" aria-label="Time line"><tbody>
          <tr><th scope="col" v-for="head in ['Start', 'Length', 'Phase', 'Why', 'Way out']"
            >{{ head }}</th></tr>
          <tr v-for="[start, long, phase, why, out] in told.spans">
            <td>{{ start.toFixed(2) }} s</td><td>{{ long.toFixed(2) }} s</td><td>{{ phase }}</td>
            <td>{{ why }}</td><td>{{ out }}</td>
          </tr>
        </tbody></table></div>
        <div class="run-figures">
          <figure v-for="(title, name) in told.figures">
            <img :src="url(path + '/figures/' + name + '.svg')" :alt="'Figure: ' + title">
            <figcaption class="run-head">
              <a v-for="kind in ['svg', 'png']" class="rcm-button" download=""
                :href="url(path + '/figures/' + name + '.' + kind)"
                >{{ title }} as {{ kind.toUpperCase() }}</a>
            </figcaption>
          </figure>
        </div>
      </template>
      <p v-else-if="!run && runs && !runs.length">There are no runs yet.</p>
      <table v-else-if="!run && runs" class="run-list" aria-label="Past runs">
        <thead><tr><th scope="col" v-for="head in ['When', 'Length', 'What', 'How it ended', '']"
          >{{ head }}</th></tr></thead>
        <tbody><tr v-for="one in runs" :key="one.name" :class="{ 'run-now': one.recording }">
          <td>{{ one.when }}</td><td>{{ length(one.seconds) }}</td>
          <td>{{ one.what }}<small>{{ one.folder }}</small></td><td>{{ one.ended }}</td>
          <td><button v-if="one.seconds !== null" type="button" class="rcm-button"
            :aria-label="'Open ' + one.folder" @click="open(one)">Open</button></td>
        </tr></tbody>
      </table>
    </div>`,
};
