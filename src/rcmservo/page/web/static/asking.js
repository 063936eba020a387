// What is going to happen once the drive is on, and what a person is asked before it can go on.
import { enable } from "./state.js";

const $ = (id) => document.getElementById(id);

export function start(rcm) {
  rcm.changed(() => show(rcm));
  document.addEventListener("submit", (event) => {
    if (event.target.id !== "asking") return;
    event.preventDefault();
    rcm.want("answer", { question: rcm.board.asks, words: $("answer").value });
    $("answer").value = "";
  });
}

function show(rcm) {
  if (!$("asking")) return;
  const asks = (rcm.connected() && rcm.board.asks) || "";
  $("intent").textContent = (rcm.connected() && rcm.board.intent) || "";
  $("asking").hidden = !asks;
  $("question").textContent = asks;
  enable("answer", rcm.may() && asks !== "");
}
