// Menu of disturbances of a simulated laboratory.
import { rcm, view } from "/rcmservo/connection.js";

const DURATION = { name: "for", default: "", unit: "s", right: "s; empty: until it is ended" };

export default {
  props: { kinds: Array },
  data() { return { selected: this.kinds[0], values: {} }; },
  computed: {
    parameters() {
      const { lasts, parameters } = this.selected;
      return lasts ? [...parameters, DURATION] : parameters;
    },
  },
  watch: {
    selected: { immediate: true, handler() {
      this.values = Object.fromEntries(this.parameters.map((one) => [one.name, one.default]));
    } },
  },
  setup: () => ({ rcm, view }),
  methods: {
    title: ({ kind }) =>
      kind === "drive_off" ? "emergency stop pressed" : kind.replaceAll("_", " "),
    begin() {
      const given = Object.entries(this.values).map(([name, text]) => [name, String(text).trim()])
        .filter(([, text]) => text !== "").map(([name, text]) => `${name}=${text}`);
      rcm.request("disturb", { disturbance: `${this.selected.kind}:${given.join(",")}` });
    },
  },
  template: `
    <div class="rcm-disturbances">
      <label>Kind <select id="disturbance-kind" class="rcm-field" aria-label="Kind of disturbance"
        :value="selected.kind" @change="selected = kinds[$event.target.selectedIndex]">
        <option v-for="one in kinds" :value="one.kind">{{ title(one) }}</option>
      </select></label>
      <span id="disturbance-parameters">
        <label v-for="one in parameters" :key="selected.kind + one.name">
          {{ one.name }}{{ one.unit ? " (" + one.unit + ")" : "" }}
          <input type="text" class="rcm-field" :name="one.name" :title="one.right"
            v-model="values[one.name]">
        </label>
      </span>
      <button type="button" class="rcm-button" :disabled="!view.may" @click="begin"
        aria-label="Begin disturbance">Begin</button>
      <button type="button" class="rcm-button" :disabled="!view.may"
        @click="rcm.request('disturb', { disturbance: '' })" aria-label="End all disturbances"
        >End all</button>
      <p>{{ selected.does }}{{ selected.lasts ? "" : "; it is permanent" }}</p>
    </div>`,
};
