// Poses: teach one by its name, go to one.
import { enable } from "./state.js";

const $ = (id) => document.getElementById(id);
const WAITING = ["OFF", "FAULT"];
let listed = null;

export function start(rcm) {
  const want = rcm.want;
  rcm.want = (what, more = {}) =>
    want(what, what === "teach" ? { name: $("name").value.trim() } : more);
  rcm.go = (name) => rcm.want("go", { name });
  rcm.changed(() => show(rcm));
}

function show(rcm) {
  if (!$("poses")) return;
  const can = rcm.may() && !WAITING.includes(rcm.board.phase);
  enable("teach", can);
  list(rcm, rcm.board.poses || []);
  for (const button of $("poses").children) button.disabled = !can;
}

function list(rcm, names) {
  const key = JSON.stringify(names);
  if (key === listed) return;
  listed = key;
  $("poses").replaceChildren(...names.map((name) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = `Go to ${name}`;
    button.setAttribute("aria-label", `Go ${name}`);
    button.onclick = () => rcm.go(name);
    return button;
  }));
}
