// What goes wrong with a simulated laboratory, chosen from a menu.
const $ = (id) => document.getElementById(id);
const DURATION = { name: "for", default: "", unit: "s", right: "s; empty: until it is ended" };

let filled = null;

export function start(rcm) {
  const kinds = window.RCMSERVO.troubles || [];
  if (kinds.length) rcm.changed(() => show(rcm, kinds));
}

function show(rcm, kinds) {
  const menu = $("trouble-kind");
  if (!menu) return;
  if (menu !== filled) fill(rcm, menu, kinds);
  for (const id of ["trouble-begin", "trouble-end"]) $(id).disabled = !rcm.may();
}

function fill(rcm, menu, kinds) {
  filled = menu;
  menu.replaceChildren(...kinds.map(({ kind }) => {
    const words = kind === "drive_off" ? "emergency stop pressed" : kind.replaceAll("_", " ");
    return new Option(words, kind);
  }));
  const chosen = () => kinds[menu.selectedIndex];
  menu.onchange = () => ask(chosen());
  $("trouble-begin").onclick = () => {
    const given = [...$("trouble-parameters").querySelectorAll("input")]
      .filter((input) => input.value.trim() !== "")
      .map((input) => `${input.name}=${input.value.trim()}`);
    rcm.want("trouble", { what: `${chosen().kind}:${given.join(",")}` });
  };
  $("trouble-end").onclick = () => rcm.want("trouble", { what: "" });
  ask(chosen());
}

function ask({ does, lasts, parameters }) {
  $("trouble-does").textContent = lasts ? does : `${does}; it stays so`;
  const fields = lasts ? [...parameters, DURATION] : parameters;
  $("trouble-parameters").replaceChildren(...fields.map((one) => {
    const label = document.createElement("label"), input = document.createElement("input");
    input.type = "text";
    input.name = one.name;
    input.value = one.default;
    input.title = one.right;
    label.append(`${one.name}${one.unit ? ` (${one.unit})` : ""} `, input);
    return label;
  }));
}
