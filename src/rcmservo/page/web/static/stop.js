// STOP, by button and space bar, and the heartbeat of the browser in control. STOP has a server
// process of its own and needs no other part of the page.
import { rcm, STOP_FAILED } from "./connection.js";

const HEARTBEAT_MS = 100, ANSWER_TIMEOUT_MS = 400;

rcm.stop = () => {
  rcm.releaseJog();
  rcm.cancelRequest(); // no earlier press may follow STOP
  rcm.stopStatus = rcm.stopLine.send("stop") ? "STOP …" : STOP_FAILED;
  rcm.send({ do: "pause" }); // in addition, in case STOP does not arrive
  setTimeout(() => { if (rcm.stopStatus) rcm.stopStatus = STOP_FAILED; rcm.refresh(); },
    ANSWER_TIMEOUT_MS);
  rcm.refresh();
};

setInterval(() => {
  if (rcm.hasControl && !rcm.isJogging()) rcm.send({ do: "beat" });
}, HEARTBEAT_MS);

const isStop = ({ target }) => target instanceof Element && target.closest("#stop") !== null;
document.addEventListener("pointerdown", (event) => { if (isStop(event)) rcm.stop(); });
document.addEventListener("click", (event) => {
  // detail 0: from a keyboard or a screen reader, without pointerdown
  if (isStop(event) && event.detail === 0) rcm.stop();
});

// The space bar is STOP and never presses the focused button.
const TEXT_TYPES = ["text", "number", "search"];
const isTyping = ({ target }) =>
  target instanceof HTMLTextAreaElement ||
  (target instanceof HTMLInputElement && TEXT_TYPES.includes(target.type));
window.addEventListener("keydown", (event) => {
  if (event.code !== "Space" || isTyping(event)) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (!event.repeat) rcm.stop();
}, true);
window.addEventListener("keyup", (event) => {
  if (event.code === "Space" && !isTyping(event)) event.preventDefault();
}, true);
