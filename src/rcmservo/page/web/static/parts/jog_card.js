// Jog: a button counts as held only while it is, in a window that is looked at. It moves joints by
// their rates, or marker 1 by its velocity in the arm's base frame.
import { can, rcm } from "/rcmservo/wire.js";

const HOLD = 40, BEGUN = 500; // ms
const ROWS = [
  { name: "Joint", of: "rates", parts: ["1", "2", "3"], called: "joint " },
  { name: "Marker 1", of: "velocity", parts: ["x", "y", "z"], called: "marker 1 along " },
];
const SIGNS = [{ sign: -1, way: "minus", drawn: "−" }, { sign: 1, way: "plus", drawn: "+" }];

let held = null;
let press = Date.now(); // another page's presses are others

const say = () => {
  if (held !== null) rcm.say({ do: "jog", ...held.motion, press: held.press });
};
setInterval(say, HOLD);

function hold(button, pointer) {
  rcm.letGo();
  const { of, place, sign } = button.dataset, numbers = [0, 0, 0];
  numbers[Number(place)] = Number(sign) * 1e6; // as fast as the share allows
  const motion = { [of]: numbers, share: Number(document.getElementById("jog-share").value) };
  held = { button, motion, pointer, press: ++press, since: performance.now() };
  button.classList.add("held");
  say();
}

rcm.jogs = () => held !== null;
rcm.letGo = () => {
  if (held === null) return;
  held.button.classList.remove("held");
  held = null;
  rcm.say({ do: "release" });
};
rcm.changed(() => {
  if (held === null) return;
  const never = performance.now() - held.since > BEGUN && rcm.board.phase !== "JOG";
  if (never || !can("jog")) rcm.letGo();
});

const jogOf = (event) => {
  const button = event.target instanceof Element ? event.target.closest(".jog") : null;
  return button && !button.disabled && held === null ? button : null;
};
document.addEventListener("pointerdown", (event) => {
  const button = jogOf(event);
  if (button && event.button === 0 && event.isPrimary && !event.ctrlKey) {
    event.preventDefault();
    button.focus();
    hold(button, event.pointerId);
  }
});
document.addEventListener("keydown", (event) => {
  const button = jogOf(event);
  if (event.code === "Enter" && button && !event.repeat) {
    event.preventDefault();
    hold(button, null);
  }
});

window.addEventListener("blur", rcm.letGo);
document.addEventListener("visibilitychange", rcm.letGo);
for (const name of ["pointerup", "pointercancel", "contextmenu"]) {
  window.addEventListener(name, rcm.letGo, true);
}
document.addEventListener("keyup", (event) => { if (event.code === "Enter") rcm.letGo(); });
window.addEventListener("pointermove", (event) => {
  if (held === null || held.pointer !== event.pointerId) return;
  const box = held.button.getBoundingClientRect();
  const on = event.clientX >= box.left && event.clientX <= box.right &&
    event.clientY >= box.top && event.clientY <= box.bottom;
  if (!on || !(event.buttons & 1)) rcm.letGo();
}, true);

export default {
  setup: () => ({ can, ROWS, SIGNS }),
  template: `
    <div class="rcm-part">
      <div class="nicegui-row row items-center rcm-tight">
        <span class="text-sm">Jog: hold a button down, from a pause</span>
        <select id="jog-share" class="rcm-field" aria-label="Jog speed">
          <option value="0.25">slow</option><option value="0.5">half</option>
          <option value="1">full</option>
        </select>
      </div>
      <div class="nicegui-row row items-center rcm-tight" v-for="{ name, of, parts, called } in ROWS">
        <span>{{ name }}</span>
        <template v-for="(part, place) in parts">
          <span>{{ part }}:</span>
          <button v-for="{ sign, way, drawn } in SIGNS" type="button" class="jog" :data-of="of"
            :data-place="place" :data-sign="sign" :disabled="!can('jog')"
            :aria-label="'Jog ' + called + part + ' ' + way"
            :title="'Jog ' + called + part + ' ' + way">{{ drawn }}</button>
        </template>
      </div>
    </div>`,
};
