// Settings: a form for each box of the servo that may change, made of what the server tells of it.
import { rcm, view } from "/rcmservo/wire.js";

const NAMES = {
  controller: "Controller", estimator: "Estimator", exploration: "Exploration",
  imaged_rcm: "Imaged RCM",
};
const AGAIN = 1000; // ms

const listed = (value) => (Array.isArray(value) ? [...value] : [value]);
const short = (value) =>
  typeof value === "number" ? String(Number(value.toPrecision(4))) : String(value);
const words = (value) => listed(value).map(short).join(", ");
const same = (one, other) => JSON.stringify(one) === JSON.stringify(other);
const fields = (form) => form.kinds[form.kind]?.fields || [];

// Have a form hold a table's values of its kind, and defaults where the table has none.
function fill(form, table) {
  form.values = Object.fromEntries(fields(form).map(({ name, default: usual }) =>
    [name, listed(name in table ? table[name] : usual)]));
}

export default {
  data: () => ({ forms: [], sent: "" }),
  computed: { count: () => view.board.settings },
  watch: { count: { immediate: true, handler: "fetchForms" } },
  setup: () => ({ NAMES, fields, fill, view, words }),
  methods: {
    async fetchForms() {
      if (this.count === undefined) return;
      const answer = await fetch(rcm.url("/settings")).catch(() => ({ ok: false }));
      if (!answer.ok) { setTimeout(() => this.fetchForms(), AGAIN); return; }
      this.forms = (await answer.json()).map((told) => {
        const old = this.forms.find(({ box }) => box === told.box);
        if (old && same(old.set, told.set)) return { ...old, in_force: told.in_force };
        const form = { ...told, kind: told.set.kind };
        fill(form, told.set);
        return form;
      });
    },
    kinds({ kinds, set }) { return [...new Set([...Object.keys(kinds), set.kind])]; },
    label: ({ name, unit }, parts, i) => (parts.length > 1 ? `${name} ${i + 1}` : name) +
      (unit ? `, ${unit.split(", ")[i % unit.split(", ").length]}` : ""),
    unit({ unit }, value, i) {
      const one = unit.split(", ")[i % unit.split(", ").length];
      return one === "rad" ? `rad = ${short(Number(value) * 180 / Math.PI)}°` : one;
    },
    // What is in force, where that is not what was set.
    now({ in_force: force, set }, name) {
      if (force === null || (force.kind === set.kind && same(force[name], set[name]))) return "";
      return `now ${words(force.kind === set.kind ? force[name] : force.kind)}`;
    },
    send(form) {
      const table = { kind: form.kind };
      for (const { name, default: usual } of fields(form)) {
        const values = form.values[name].map((one) => (one === "" ? null : one));
        table[name] = Array.isArray(usual) ? values : values[0];
      }
      this.sent = form.box;
      rcm.want("set", { box: form.box, table });
    },
  },
  template: `
    <div class="rcm-settings">
      <form v-for="form in forms" :key="form.box" novalidate :data-box="form.box"
        :aria-label="NAMES[form.box]" @submit.prevent="send(form)">
        <h3>{{ NAMES[form.box] }}<small>{{ form.at_once
          ? "holds at once, also in motion" : "holds from the next session on" }}</small></h3>
        <select class="rcm-field kind" v-show="kinds(form).length > 1" v-model="form.kind"
          :aria-label="NAMES[form.box] + ' kind'"
          @change="fill(form, form.kind === form.set.kind ? form.set : {})">
          <option v-for="name in kinds(form)">{{ name }}</option>
        </select>
        <p>{{ form.kinds[form.kind]?.words }}</p>
        <div class="field" v-for="field in fields(form)" :key="form.kind + field.name"
          :data-field="field.name">
          <b>{{ field.name }}</b>
          <span class="inputs"><template v-for="(value, i) in form.values[field.name]">
            <select v-if="field.choices.length" class="rcm-field" :aria-label="field.name"
              v-model="form.values[field.name][i]">
              <option v-for="one in field.choices">{{ one }}</option>
            </select>
            <input v-else-if="typeof value === 'boolean'" type="checkbox" :aria-label="field.name"
              v-model="form.values[field.name][i]">
            <template v-else>
              <input type="number" step="any" class="rcm-field"
                :aria-label="label(field, form.values[field.name], i)"
                v-model.number="form.values[field.name][i]">
              <span class="unit">{{ unit(field, value, i) }}</span>
            </template>
          </template></span>
          <small>default {{ words(field.default) }}</small>
          <small class="in-force">{{ now(form, field.name) }}</small>
          <p>{{ field.words }}</p>
        </div>
        <div class="buttons">
          <button class="rcm-button set" :disabled="!view.may"
            >Set {{ NAMES[form.box].toLowerCase() }}</button>
          <button class="rcm-button" type="button" :aria-label="NAMES[form.box] + ' defaults'"
            @click="fill(form, {})">Defaults</button>
          <span class="refused" role="alert">{{ sent === form.box ? view.refused : "" }}</span>
        </div>
      </form>
    </div>`,
};
