// Jog buttons: each moves one joint, or marker 1 along an axis of the arm's base frame, as long as
// it is held down in a focused, visible window.
import { can, rcm } from "/rcmservo/connection.js";

const REPEAT_MS = 40, PAUSE_TIMEOUT_MS = 1000;
const FULL_SPEED = 1e6; // the servo limits it to the jog speed
const ROWS = [
  { name: "Joint", quantity: "rates", axes: ["1", "2", "3"], prefix: "joint " },
  { name: "Marker 1", quantity: "velocity", axes: ["x", "y", "z"], prefix: "marker 1 along " },
];
const DIRECTIONS = [
  { sign: -1, direction: "minus", symbol: "−" }, { sign: 1, direction: "plus", symbol: "+" },
];

let held = null; // the button that is held down, and its motion
let pressNumber = Date.now(); // differs from the presses of earlier pages

const sendJog = () => {
  if (held !== null) rcm.send({ do: "jog", ...held.motion, press: held.press });
};
setInterval(sendJog, REPEAT_MS);

function hold(button, pointer) {
  rcm.releaseJog();
  const { quantity, axis, sign } = button.dataset, values = [0, 0, 0];
  values[Number(axis)] = Number(sign) * FULL_SPEED;
  const speed_scale = Number(document.getElementById("jog-speed").value);
  const motion = { [quantity]: values, speed_scale };
  held = { button, motion, pointer, press: ++pressNumber, movedAt: performance.now() };
  button.classList.add("held");
  sendJog();
}

rcm.isJogging = () => held !== null;
rcm.releaseJog = () => {
  if (held === null) return;
  held.button.classList.remove("held");
  held = null;
  rcm.send({ do: "release" });
};
rcm.onChange(() => {
  if (held === null) return;
  // a late command stops the tool, which moves again with the next one
  if (rcm.board.phase === "JOG") held.movedAt = performance.now();
  const isOver = performance.now() - held.movedAt > PAUSE_TIMEOUT_MS;
  if (isOver) rcm.refusal = "the tool is not jogged any more: press the button again";
  if (isOver || !can("jog")) rcm.releaseJog();
});

const findJogButton = (event) => {
  const button = event.target instanceof Element ? event.target.closest(".jog") : null;
  return button && !button.disabled && held === null ? button : null;
};
document.addEventListener("pointerdown", (event) => {
  const button = findJogButton(event);
  if (button && event.button === 0 && event.isPrimary && !event.ctrlKey) {
    event.preventDefault();
    button.focus();
    hold(button, event.pointerId);
  }
});
document.addEventListener("keydown", (event) => {
  const button = findJogButton(event);
  if (event.code === "Enter" && button && !event.repeat) {
    event.preventDefault();
    hold(button, null);
  }
});

window.addEventListener("blur", rcm.releaseJog);
document.addEventListener("visibilitychange", rcm.releaseJog);
for (const name of ["pointerup", "pointercancel", "contextmenu"]) {
  window.addEventListener(name, rcm.releaseJog, true);
}
document.addEventListener("keyup", (event) => { if (event.code === "Enter") rcm.releaseJog(); });
window.addEventListener("pointermove", (event) => {
  if (held === null || held.pointer !== event.pointerId) return;
  const box = held.button.getBoundingClientRect();
  const isInside = event.clientX >= box.left && event.clientX <= box.right &&
    event.clientY >= box.top && event.clientY <= box.bottom;
  if (!isInside || !(event.buttons & 1)) rcm.releaseJog();
}, true);

export default {
  setup: () => ({ can, ROWS, DIRECTIONS }),
  template: `
    <div class="rcm-widget">
      <div class="nicegui-row row items-center rcm-tight">
        <span class="text-sm">Jog while paused: hold a button down</span>
        <select id="jog-speed" class="rcm-field" aria-label="Jog speed">
          <option value="0.25">slow</option><option value="0.5">half</option>
          <option value="1">full</option>
        </select>
      </div>
      <div class="nicegui-row row items-center rcm-tight"
        v-for="{ name, quantity, axes, prefix } in ROWS">
        <span>{{ name }}</span>
        <template v-for="(axis, index) in axes">
          <span>{{ axis }}:</span>
          <button v-for="{ sign, direction, symbol } in DIRECTIONS" type="button" class="jog"
            :data-quantity="quantity" :data-axis="index" :data-sign="sign" :disabled="!can('jog')"
            :aria-label="'Jog ' + prefix + axis + ' ' + direction"
            :title="'Jog ' + prefix + axis + ' ' + direction">{{ symbol }}</button>
        </template>
      </div>
    </div>`,
};
