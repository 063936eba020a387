// Settings: a form for each box of the servo that may change, made of what the server tells of it.
const $ = (id) => document.getElementById(id);

let count = null, forms = [], told = null;

export function start(rcm) {
  rcm.set = (box) => {
    told = box;
    rcm.want("set", { box, table: read(box) });
  };
  rcm.changed(() => show(rcm));
}

function show(rcm) {
  if (!$("standing") || !$("settings")) return;
  $("standing").textContent = rcm.connected() ? rcm.board.standing || "" : "";
  if (rcm.board.settings !== undefined && rcm.board.settings !== count) {
    count = rcm.board.settings;
    fetchForms(rcm);
  }
  for (const form of $("settings").children) {
    form.querySelector(".set").disabled = !rcm.may();
    form.querySelector(".refused").textContent = told === form.dataset.box ? rcm.refused : "";
  }
}

async function fetchForms(rcm) {
  const answer = await fetch(rcm.url("/settings"));
  if (!answer.ok) { count = null; return; }
  forms = await answer.json();
  for (const about of forms) {
    const old = formOf(about.box), had = old && old.dataset.set;
    if (old && had === JSON.stringify(about.set)) { tellInForce(old, about); continue; }
    const made = form(rcm, about);
    if (old) old.replaceWith(made); else $("settings").append(made);
  }
  show(rcm);
}

const formOf = (box) => document.querySelector(`#settings form[data-box="${box}"]`);

function element(kind, words = "", more = {}) {
  const made = document.createElement(kind);
  made.textContent = words;
  for (const [key, value] of Object.entries(more)) made.setAttribute(key, value);
  return made;
}

function form(rcm, about) {
  const made = element("form", "", { "data-box": about.box, "aria-label": about.title });
  made.dataset.set = JSON.stringify(about.set);
  made.noValidate = true; // the server says what is wrong
  const when = about.at_once ? "holds at once, also in motion" : "holds from the next session on";
  const head = element("h3", about.title);
  head.append(element("small", when));
  const kind = element("select", "", { "aria-label": `${about.title} kind` });
  const names = Object.keys(about.kinds), own = about.set.kind;
  if (!names.includes(own)) names.push(own);
  kind.append(...names.map((name) => element("option", name, { value: name })));
  kind.value = own;
  kind.hidden = names.length < 2;
  kind.classList.add("kind");
  const fields = element("div", "", { class: "fields" });
  const fill = (values) => {
    const { words = "", fields: all = [] } = about.kinds[kind.value] || {};
    fields.replaceChildren(element("p", words), ...all.map((one) => row(one, values)));
    tellInForce(made, about);
  };
  kind.onchange = () => fill(kind.value === own ? about.set : {});
  const set = element("button", `Set ${about.title.toLowerCase()}`, { class: "set" });
  const defaults = element("button", "Defaults", { type: "button" });
  defaults.setAttribute("aria-label", `${about.title} defaults`);
  defaults.onclick = () => fill({});
  made.onsubmit = (event) => { event.preventDefault(); rcm.set(about.box); };
  const buttons = element("div", "", { class: "buttons" });
  buttons.append(set, defaults, element("span", "", { class: "refused", role: "alert" }));
  made.append(head, kind, fields, buttons);
  fill(about.set);
  return made;
}

function row(field, values) {
  const value = field.name in values ? values[field.name] : field.default;
  const made = element("div", "", { class: "field", "data-field": field.name });
  const units = field.unit.split(", ");
  const parts = Array.isArray(value) ? value : [value];
  const inputs = element("span", "", { class: "inputs" });
  parts.forEach((part, i) => {
    const label = parts.length > 1 ? `${field.name} ${i + 1}` : field.name;
    inputs.append(...input(field, part, label, units[i % units.length]));
  });
  const usual = (Array.isArray(field.default) ? field.default : [field.default]).map(short);
  made.append(element("b", field.name), inputs, element("small", `default ${usual.join(", ")}`),
    element("small", "", { class: "in-force" }), element("p", field.words));
  return made;
}

function input(field, value, label, unit) {
  if (field.choices.length > 0) {
    const made = element("select", "", { "aria-label": label });
    made.append(...field.choices.map((one) => element("option", one, { value: one })));
    made.value = value;
    return [made];
  }
  const yes = typeof value === "boolean";
  const made = element("input", "", { "aria-label": unit ? `${label}, ${unit}` : label });
  made.type = yes ? "checkbox" : "number";
  if (yes) { made.checked = value; return [made]; }
  made.step = "any";
  made.value = value;
  const after = element("span", "", { class: "unit" });
  const tell = () => {
    const degrees = unit === "rad" ? ` = ${short(made.valueAsNumber * 180 / Math.PI)}°` : "";
    after.textContent = unit + degrees;
  };
  made.oninput = tell;
  tell();
  return [made, after];
}

const short = (value) =>
  typeof value === "number" ? String(Number(value.toPrecision(4))) : String(value);

// The table of a box as the form has it.
function read(box) {
  const made = formOf(box);
  const table = { kind: made.querySelector(".kind").value };
  const about = forms.find((one) => one.box === box);
  for (const field of about.kinds[table.kind]?.fields || []) {
    const at = made.querySelectorAll(`[data-field="${field.name}"] :is(input, select)`);
    const values = [...at].map(valueOf);
    table[field.name] = Array.isArray(field.default) ? values : values[0];
  }
  return table;
}

function valueOf(one) {
  if (one.type === "checkbox") return one.checked;
  if (one.type !== "number") return one.value;
  return Number.isFinite(one.valueAsNumber) ? one.valueAsNumber : null;
}

// Beside each field what is in force, where that is not what was set.
function tellInForce(made, about) {
  const force = about.in_force;
  for (const row of made.querySelectorAll(".field")) {
    const name = row.dataset.field;
    const same = force === null || (force.kind === about.set.kind &&
      JSON.stringify(force[name]) === JSON.stringify(about.set[name]));
    const now = force && force.kind === about.set.kind && name in force ? force[name] : force?.kind;
    row.querySelector(".in-force").textContent =
      same ? "" : `now ${(Array.isArray(now) ? now : [now]).map(short).join(", ")}`;
  }
}
