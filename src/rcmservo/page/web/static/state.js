// How the servo stands, the buttons that lead on, and STOP.
const $ = (id) => document.getElementById(id);
const UNHEARD = "STOP was not heard: use the emergency stop of the arm";
const UNHEARD_NOW = "STOP is not connected: use the emergency stop of the arm";
const MOVES = ["ACQUIRE", "SERVO", "HOLD"], WAITING = ["OFF", "FAULT"];
const BEAT = 100, SHOWN = 250, ANSWER = 400; // ms

let stopWords = "";

export function start(rcm) {
  rcm.stopHeard = (heard) => { stopWords = heard ? "" : UNHEARD; };
  rcm.stop = () => {
    rcm.letGo();
    rcm.forget(); // nothing that was pressed before comes after it
    stopWords = "STOP …";
    if (!rcm.stopLine.say("stop")) stopWords = UNHEARD;
    rcm.say({ do: "pause" }); // beside it, should that be what is left
    setTimeout(() => { if (stopWords) stopWords = UNHEARD; rcm.show(); }, ANSWER);
    rcm.show();
  };
  rcm.changed(() => show(rcm));
  setInterval(rcm.show, SHOWN);
  setInterval(() => { if (rcm.holds && !rcm.jogs()) rcm.say({ do: "beat" }); }, BEAT);
  press(rcm);
  space(rcm);
}

function press(rcm) {
  document.addEventListener("pointerdown", (event) => {
    if (event.target instanceof Element && event.target.closest("#stop")) rcm.stop();
  });
  document.addEventListener("click", (event) => {
    // of a keyboard or a screen reader: no pointer went down
    const at = event.target instanceof Element ? event.target.closest("#stop") : null;
    if (at && event.detail === 0) rcm.stop();
  });
}

// The space bar is STOP, and never presses the button that has the focus.
function space(rcm) {
  const types = ["text", "number", "search"];
  const typing = ({ target }) =>
    target instanceof HTMLTextAreaElement ||
    (target instanceof HTMLInputElement && types.includes(target.type));
  window.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || typing(event)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) rcm.stop();
  }, true);
  window.addEventListener("keyup", (event) => {
    if (event.code === "Space" && !typing(event)) event.preventDefault();
  }, true);
}

function show(rcm) {
  const state = $("state");
  if (!state) return;
  const board = rcm.board, connected = rcm.connected();
  state.dataset.phase = board.phase || "";
  state.dataset.action = board.action || "";
  state.classList.toggle("lost", !connected);
  $("phase").textContent = connected ? board.words || "" : "no connection to the server";
  $("why").textContent = connected ? board.why || "" : "";
  $("way").textContent = connected && board.way_out ? `→ ${board.way_out}` : "";
  $("errors").textContent = connected && MOVES.includes(board.phase) ? errors(board) : "";
  $("control").textContent = rcm.holds
    ? rcm.asked ? "you have control; another browser asks for it" : "you have control"
    : "you watch";
  $("notes").textContent = [...(board.notes || []), rcm.refused].filter(Boolean).join("\n");
  $("unheard").textContent = stopWords || (rcm.stopLine.wire === null ? UNHEARD_NOW : "");
  $("stop").classList.toggle("deaf", rcm.stopLine.wire === null);
  const may = rcm.may(), moving = !WAITING.includes(board.phase);
  enable("enable", may && board.ready);
  enable("pause", may && moving && board.phase !== "PAUSED");
  enable("resume", may && board.phase === "PAUSED");
  enable("show", may && moving);
  enable("clear", may && board.clears);
  for (const button of document.querySelectorAll("[data-do]")) {
    button.classList.toggle("way", (board.ways || []).includes(button.dataset.do));
  }
  enable("ask", connected && !rcm.holds);
  enable("give", may && rcm.asked);
}

function errors(board) {
  if (!Array.isArray(board.delta) || board.delta.includes(null)) return "exploring";
  const [s, r, d] = board.delta;
  const degrees = (s * 180 / Math.PI).toFixed(2);
  const truth = board.truth_mm == null ? "" : `  truth: ${board.truth_mm.toFixed(2)} mm off`;
  return `Δs ${degrees}°  Δr ${r.toFixed(1)} px  Δd ${d.toFixed(1)} px${truth}`;
}

// Whether a button that says something can be pressed.
export function enable(what, can) {
  const button = document.querySelector(`[data-do="${what}"]`);
  if (!button) return;
  button.disabled = !can;
  button.classList.toggle("disabled", !can);
  button.setAttribute("aria-disabled", String(!can));
}
