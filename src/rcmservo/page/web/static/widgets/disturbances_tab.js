// Tab of the disturbances that the user can request of the simulated arm or camera.
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
      this.values = Object.fromEntries(
        this.parameters.map(({ name, default: standard }) => [name, standard]));
    } },
  },
  setup: () => ({ rcm, view }),
  methods: {
    title: ({ kind }) =>
      kind === "drive_off" ? "emergency stop pressed" : kind.replaceAll("_", " "),
    begin() {
      const parameters = Object.entries(this.values)
        .map(([name, text]) => [name, String(text).trim()])
        .filter(([, text]) => text !== "").map(([name, text]) => `${name}=${text}`);
      rcm.request("disturb", { disturbance: `${this.selected.kind}:${parameters.join(",")}` });
    },
  },
  template: `
    <div class="rcm-disturbances">
      <div>Disturb the simulated arm or camera. The state on the right shows the effect.</div>
      <label>Kind <select id="disturbance-kind" class="rcm-field" aria-label="Kind of disturbance"
        :value="selected.kind" @change="selected = kinds[$event.target.selectedIndex]">
        <option v-for="disturbance in kinds" :value="disturbance.kind">{{ title(disturbance) }}
        </option>
      </select></label>
      <span id="disturbance-parameters">
        <label v-for="{ name, unit, right } in parameters" :key="selected.kind + name">
          {{ name }}{{ unit ? " (" + unit + ")" : "" }}
          <input type="text" class="rcm-field" :name="name" :title="right" v-model="values[name]">
        </label>
      </span>
      <button type="button" class="rcm-button" :disabled="!view.mayOperate" @click="begin"
        aria-label="Begin disturbance">Begin</button>
      <button type="button" class="rcm-button" :disabled="!view.mayOperate"
        @click="rcm.request('disturb', { disturbance: '' })" aria-label="End all disturbances"
        >End all</button>
      <p>{{ selected.does }}{{ selected.lasts ? "" : "; it is permanent" }}</p>
    </div>`,
};
