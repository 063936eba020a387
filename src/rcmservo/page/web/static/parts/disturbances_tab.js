// What goes wrong with a simulated laboratory, chosen from a menu.
import { rcm, view } from "/rcmservo/wire.js";

const DURATION = { name: "for", default: "", unit: "s", right: "s; empty: until it is ended" };

export default {
  props: { kinds: Array },
  data() { return { chosen: this.kinds[0], given: {} }; },
  computed: {
    fields() {
      return this.chosen.lasts ? [...this.chosen.parameters, DURATION] : this.chosen.parameters;
    },
  },
  watch: {
    chosen: { immediate: true, handler() {
      this.given = Object.fromEntries(this.fields.map((one) => [one.name, one.default]));
    } },
  },
  setup: () => ({ rcm, view }),
  methods: {
    words: ({ kind }) => (kind === "drive_off" ? "emergency stop pressed" : kind.replaceAll("_", " ")),
    begin() {
      const given = Object.entries(this.given).map(([name, text]) => [name, String(text).trim()])
        .filter(([, text]) => text !== "").map(([name, text]) => `${name}=${text}`);
      rcm.want("trouble", { what: `${this.chosen.kind}:${given.join(",")}` });
    },
  },
  template: `
    <div class="rcm-trouble">
      <label>What <select id="trouble-kind" class="rcm-field" aria-label="Kind of trouble"
        :value="chosen.kind" @change="chosen = kinds[$event.target.selectedIndex]">
        <option v-for="one in kinds" :value="one.kind">{{ words(one) }}</option>
      </select></label>
      <span id="trouble-parameters">
        <label v-for="one in fields" :key="chosen.kind + one.name">
          {{ one.name }}{{ one.unit ? " (" + one.unit + ")" : "" }}
          <input type="text" class="rcm-field" :name="one.name" :title="one.right"
            v-model="given[one.name]">
        </label>
      </span>
      <button type="button" class="rcm-button" :disabled="!view.may" @click="begin"
        aria-label="Begin trouble">Begin</button>
      <button type="button" class="rcm-button" :disabled="!view.may"
        @click="rcm.want('trouble', { what: '' })" aria-label="End all trouble">End all</button>
      <p>{{ chosen.does }}{{ chosen.lasts ? "" : "; it stays so" }}</p>
    </div>`,
};
