// Poses: teach one by its name, go to one.
import { enable } from "./state.js";

const $ = (id) => document.getElementById(id);
const WAITING = ["OFF", "FAULT"];
const SURE = 3000; // ms
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
  list(rcm, rcm.board);
  for (const button of $("poses").querySelectorAll(".go")) button.disabled = !can;
  for (const button of $("poses").querySelectorAll(".delete")) button.disabled = !rcm.may();
  const again = (rcm.board.poses || []).includes($("name").value.trim());
  const words = document.querySelector('[data-do="teach"] .block');
  if (words) words.textContent = again ? "Overwrite" : "Teach";
}

// Each pose with what was seen as it was taught; one that this rig refuses, with the reason.
function list(rcm, board) {
  const names = board.poses || [], refused = Object.entries(board.refused_poses || {});
  const key = JSON.stringify([names, refused, board.kept]);
  if (key === listed) return;
  listed = key;
  $("poses").replaceChildren(
    ...names.map((name) => row(rcm, name, "")),
    ...refused.map(([name, why]) => row(rcm, name, why)),
  );
}

function row(rcm, name, why) {
  const row = document.createElement("div"), picture = document.createElement("img");
  row.className = "pose";
  picture.alt = "";
  picture.onerror = () => picture.remove();
  picture.src = rcm.url(`/pose?name=${encodeURIComponent(name)}&kept=${rcm.board.kept}`);
  const words = why ? document.createElement("span") : button(`Go ${name}`, `Go ${name}`, "go");
  if (why) words.textContent = `${name}: ${why}`;
  else words.onclick = () => rcm.go(name);
  const gone = button(`Delete ${name}`, "×", "delete");
  gone.onclick = () => sure(gone, () => rcm.want("delete", { name }));
  row.append(picture, words, gone);
  return row;
}

function button(called, words, kind) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = kind;
  button.textContent = words;
  button.setAttribute("aria-label", called);
  return button;
}

// What cannot be undone is done at the second press.
function sure(button, act) {
  if (button.dataset.asked) return act();
  const words = button.textContent;
  button.dataset.asked = "yes";
  button.textContent = "sure?";
  setTimeout(() => { delete button.dataset.asked; button.textContent = words; }, SURE);
}
