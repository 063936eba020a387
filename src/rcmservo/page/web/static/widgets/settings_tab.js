// Tab of the settings: a form for each part of the servo that may change. The server describes the
// forms, see web/setting_fields.py.
import { rcm, view } from "/rcmservo/connection.js";

const RETRY_MS = 1000;

const toList = (value) => (Array.isArray(value) ? [...value] : [value]);
const toShortText = (value) =>
  typeof value === "number" ? String(Number(value.toPrecision(4))) : String(value);
const toText = (value) => toList(value).map(toShortText).join(", ");
const isEqual = (first, second) => JSON.stringify(first) === JSON.stringify(second);
const fields = (form) => form.kinds[form.kind]?.fields || [];
// Unit of the i-th number of a field, whose units may repeat: "rad, px" holds for 4 numbers.
const unitOf = (unit, i) => unit.split(", ")[i % unit.split(", ").length];

// Fill a form with the values of a table, and with defaults for missing ones.
function fill(form, table) {
  form.values = Object.fromEntries(fields(form).map(({ name, default: standard }) =>
    [name, toList(name in table ? table[name] : standard)]));
}

export default {
  data: () => ({ forms: [], sentPart: "" }),
  computed: { version: () => view.board.settings_version },
  watch: { version: { immediate: true, handler: "fetchForms" } },
  setup: () => ({ fields, fill, toText, view }),
  methods: {
    async fetchForms() {
      if (this.version === undefined) return;
      const response = await fetch(rcm.url("/settings")).catch(() => ({ ok: false }));
      if (!response.ok) { setTimeout(() => this.fetchForms(), RETRY_MS); return; }
      this.forms = (await response.json()).map((description) => {
        const shownForm = this.forms.find(({ part }) => part === description.part);
        if (shownForm && isEqual(shownForm.selected, description.selected)) {
          return { ...shownForm, active: description.active }; // keeps what the user has typed
        }
        const form = { ...description, kind: description.selected.kind };
        fill(form, description.selected);
        return form;
      });
    },
    kinds: ({ kinds, selected }) => [...new Set([...Object.keys(kinds), selected.kind])],
    label: ({ name, unit }, values, i) => (values.length > 1 ? `${name} ${i + 1}` : name) +
      (unit ? `, ${unitOf(unit, i)}` : ""),
    unit({ unit }, value, i) {
      const symbol = unitOf(unit, i);
      return symbol === "rad" ? `rad = ${toShortText(Number(value) * 180 / Math.PI)}°` : symbol;
    },
    // Return the active value if it differs from the selected one.
    activeText({ active, selected }, name) {
      const isSameKind = active?.kind === selected.kind;
      if (active === null || (isSameKind && isEqual(active[name], selected[name]))) return "";
      return `now ${toText(isSameKind ? active[name] : active.kind)}`;
    },
    send(form) {
      const table = { kind: form.kind };
      for (const { name, default: standard } of fields(form)) {
        const values = form.values[name].map((value) => (value === "" ? null : value));
        table[name] = Array.isArray(standard) ? values : values[0];
      }
      this.sentPart = form.part;
      rcm.request("set", { part: form.part, table });
    },
  },
  template: `
    <div class="rcm-settings">
      <form v-for="form in forms" :key="form.part" novalidate :data-part="form.part"
        :aria-label="form.title" @submit.prevent="send(form)">
        <h3>{{ form.title }}<small>{{ form.immediate
          ? "takes effect at once, also in motion" : "takes effect in the next session"
          }}</small></h3>
        <select class="rcm-field kind" v-show="kinds(form).length > 1" v-model="form.kind"
          :aria-label="form.title + ' kind'"
          @change="fill(form, form.kind === form.selected.kind ? form.selected : {})">
          <option v-for="name in kinds(form)">{{ name }}</option>
        </select>
        <p>{{ form.kinds[form.kind]?.description }}</p>
        <div class="field" v-for="field in fields(form)" :key="form.kind + field.name"
          :data-field="field.name">
          <b>{{ field.name }}</b>
          <span class="inputs"><template v-for="(value, i) in form.values[field.name]">
            <select v-if="field.choices.length" class="rcm-field" :aria-label="field.name"
              v-model="form.values[field.name][i]">
              <option v-for="choice in field.choices">{{ choice }}</option>
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
          <small>default {{ toText(field.default) }}</small>
          <small class="active">{{ activeText(form, field.name) }}</small>
          <p>{{ field.description }}</p>
        </div>
        <div class="buttons">
          <button class="rcm-button apply" :disabled="!view.mayOperate"
            :aria-label="'Apply ' + form.title">Apply</button>
          <button class="rcm-button" type="button" :aria-label="form.title + ' defaults'"
            @click="fill(form, {})">Defaults</button>
          <span class="refused" role="alert"
            >{{ sentPart === form.part ? view.refusal : "" }}</span>
        </div>
      </form>
    </div>`,
};
