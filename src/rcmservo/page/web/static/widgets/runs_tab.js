// Tab of the past runs: the list, and an opened run with its replay, figures and files.
import { drawPicture } from "/rcmservo/drawings/picture.js";
import { rcm } from "/rcmservo/connection.js";

const REFRESH_MS = 5000, FRAME_MS = 50;
const GREY = "#8a8a8a";

// Return the server's response; raise a refusal as an error with its reason.
async function fetchData(path) {
  const response = await fetch(rcm.url(path), { cache: "no-store" });
  if (response.ok) return response;
  const { detail } = await response.json().catch(() => ({}));
  throw new Error(typeof detail === "string" ? detail : "the server cannot answer");
}

function blankImage([width, height]) {
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
  context.fillStyle = GREY;
  context.fillRect(0, 0, width, height);
  return canvas;
}

// Replay of an opened run: recorded pictures with the recorded overlay, and a time slider.
const Replay = {
  props: { path: String, content: Object },
  data: () => ({ shownIndex: 0, text: "", playTimer: null, isDrawing: false }),
  computed: { lastIndex() { return this.content.moments.length - 1; } },
  mounted() { this.show(0); },
  unmounted() { clearTimeout(this.playTimer); },
  methods: {
    async show(i) {
      const { moments, spans } = this.content, [, , phase, cause] = spans[moments[i].span] || [];
      this.shownIndex = i;
      this.text = `${moments[i].t.toFixed(2)} s · ${[phase, cause].filter(Boolean).join(" · ")}`;
      if (this.isDrawing) return;
      this.isDrawing = true;
      try {
        for (let drawnIndex = -1; drawnIndex !== this.shownIndex;) { // only the newest request
          drawnIndex = this.shownIndex;
          await this.draw(moments[drawnIndex]);
        }
      } catch (error) {
        this.text = error.message;
      } finally {
        this.isDrawing = false;
      }
    },
    async draw({ points, rcm: o_c, stage, picture }) {
      const image = picture < 0 ? blankImage(this.content.size)
        : await createImageBitmap(
          await (await fetchData(`${this.path}/pictures/${picture}`)).blob());
      if (this.$refs.canvas) {
        const target = this.content.targets[stage];
        drawPicture(this.$refs.canvas, image, { points, rcm: o_c, target });
      }
      image.close?.();
    },
    togglePlay() {
      clearTimeout(this.playTimer);
      if (this.playTimer !== null) { this.playTimer = null; return; }
      const { moments } = this.content;
      let i = this.shownIndex >= this.lastIndex ? 0 : this.shownIndex;
      const startMs = performance.now() - 1000 * moments[i].t;
      const step = () => {
        if (!this.$el.isConnected) { this.playTimer = null; return; }
        const replayedS = (performance.now() - startMs) / 1000;
        while (i < this.lastIndex && moments[i + 1].t <= replayedS) i += 1;
        if (i !== this.shownIndex) this.show(i);
        this.playTimer = i < this.lastIndex ? setTimeout(step, FRAME_MS) : null;
      };
      step();
    },
  },
  template: `
    <div class="run-replay">
      <div class="run-banner">Replay of a past run: the live picture is above</div>
      <canvas ref="canvas" role="img" aria-label="Picture of the past run"></canvas>
      <div class="run-head">
        <button type="button" class="rcm-button" @click="togglePlay">
          {{ playTimer === null ? "Play" : "Pause replay" }}</button>
        <input type="range" min="0" :max="lastIndex" step="1" :value="shownIndex"
          :aria-valuetext="text" aria-label="Time in the past run"
          @input="show(Number($event.target.value))">
      </div>
      <div class="run-moment">{{ text }}</div>
    </div>`,
};

export default {
  components: { Replay },
  setup: () => ({ headings: ["Last change", "Length", "Arm and estimator", "End", ""] }),
  data: () => ({ runs: null, run: null, content: null, error: "" }), // run: the opened one
  computed: {
    path() { return `/runs/${this.run.name}`; },
    summary() {
      const missing = this.content.missing ? [["missing", this.content.missing]] : [];
      return [...missing, ["verdict", this.content.verdict], ...this.content.summary];
    },
  },
  mounted() {
    this.fetchRuns();
    setInterval(() => { if (this.$el.offsetParent && !this.run) this.fetchRuns(); }, REFRESH_MS);
  },
  methods: {
    url: rcm.url,
    async fetchRuns() {
      try {
        this.runs = await (await fetchData("/runs")).json();
        if (!this.run) this.error = "";
      } catch (error) {
        if (!this.run) this.error = error.message;
      }
    },
    async open(run) {
      [this.run, this.content, this.error] = [run, null, ""];
      this.$nextTick(() => this.$refs.back.focus());
      const content = await fetchData(this.path).then((response) => response.json())
        .catch((error) => error);
      if (this.run !== run) return;
      if (content instanceof Error) this.error = content.message;
      else this.content = Object.freeze(content); // too large to be reactive
    },
    close() {
      [this.run, this.content, this.error] = [null, null, ""];
      this.fetchRuns();
    },
    formatLength(seconds) {
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
        <strong>Past run {{ run.folder }}, {{ run.changed }}</strong>
      </div>
      <p v-if="run && !content && !error" role="status">The record is being read …</p>
      <div v-if="content || (run && error)" class="run-head">
        <a class="rcm-button" download="" :href="url(path + '/record.mcap')"
          >Download the record (MCAP)</a>
      </div>
      <p v-if="error" role="alert" class="run-alert">{{ error }}</p>
      <template v-if="content">
        <replay v-if="content.moments.length" :path="path" :content="content"></replay>
        <p v-else>The record holds no tick.</p>
        <table class="run-list" aria-label="Summary"><tbody>
          <tr v-for="[name, text] in summary">
            <th scope="row">{{ name }}</th><td>{{ text }}</td></tr>
        </tbody></table>
        <div class="run-lines"><table class="run-list" aria-label="Time line"><tbody>
          <tr><th scope="col" v-for="head in ['Start', 'Length', 'Phase', 'Cause', 'Recovery']"
            >{{ head }}</th></tr>
          <tr v-for="[start, length, phase, cause, recovery] in content.spans">
            <td>{{ start.toFixed(2) }} s</td><td>{{ length.toFixed(2) }} s</td><td>{{ phase }}</td>
            <td>{{ cause }}</td><td>{{ recovery }}</td>
          </tr>
        </tbody></table></div>
        <div class="run-figures">
          <figure v-for="(title, name) in content.figures">
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
        <thead><tr><th scope="col" v-for="head in headings">{{ head }}</th></tr></thead>
        <tbody><tr v-for="past in runs" :key="past.name" :class="{ 'run-now': past.is_recording }">
          <td>{{ past.changed }}</td><td>{{ formatLength(past.seconds) }}</td>
          <td>{{ past.description }}<small>{{ past.folder }}</small></td><td>{{ past.ending }}</td>
          <td><button v-if="past.seconds !== null" type="button" class="rcm-button"
            :aria-label="'Open ' + past.folder" @click="open(past)">Open</button></td>
        </tr></tbody>
      </table>
    </div>`,
};
