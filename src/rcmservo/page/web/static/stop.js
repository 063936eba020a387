// STOP, which nothing else on the page is needed for, and the sign of life of who has control.
import { rcm, UNHEARD } from "./wire.js";

const BEAT = 100, ANSWER = 400; // ms

rcm.stop = () => {
  rcm.letGo();
  rcm.forget(); // nothing that was pressed before comes after it
  rcm.stopWords = rcm.stopLine.say("stop") ? "STOP …" : UNHEARD;
  rcm.say({ do: "pause" }); // beside it, should that be what is left
  setTimeout(() => { if (rcm.stopWords) rcm.stopWords = UNHEARD; rcm.show(); }, ANSWER);
  rcm.show();
};

setInterval(() => { if (rcm.holds && !rcm.jogs()) rcm.say({ do: "beat" }); }, BEAT);

const isStop = ({ target }) => target instanceof Element && target.closest("#stop") !== null;
document.addEventListener("pointerdown", (event) => { if (isStop(event)) rcm.stop(); });
document.addEventListener("click", (event) => {
  // of a keyboard or a screen reader: no pointer went down
  if (isStop(event) && event.detail === 0) rcm.stop();
});

// The space bar is STOP, and never presses the button that has the focus.
const TYPES = ["text", "number", "search"];
const typing = ({ target }) =>
  target instanceof HTMLTextAreaElement ||
  (target instanceof HTMLInputElement && TYPES.includes(target.type));
window.addEventListener("keydown", (event) => {
  if (event.code !== "Space" || typing(event)) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (!event.repeat) rcm.stop();
}, true);
window.addEventListener("keyup", (event) => {
  if (event.code === "Space" && !typing(event)) event.preventDefault();
}, true);
