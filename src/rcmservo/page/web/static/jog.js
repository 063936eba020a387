// Jog: a button counts as held only while it is, in a window that is looked at. It moves joints by
// their rates, or marker 1 by its velocity in the arm's base frame.
const HOLD = 40, BEGUN = 500; // ms
const FROM = ["IDLE", "PAUSED", "JOG"];

let held = null;
let press = Date.now(); // another page's presses are others

export function start(rcm) {
  const say = () => {
    if (held !== null) rcm.say({ do: "jog", ...held.motion, press: held.press });
  };
  rcm.jogs = () => held !== null;
  rcm.letGo = () => {
    if (held === null) return;
    held.button.classList.remove("held");
    held = null;
    rcm.say({ do: "release" });
  };
  const hold = (button, pointer) => {
    rcm.letGo();
    const { of, place, sign } = button.dataset, numbers = [0, 0, 0];
    numbers[Number(place)] = Number(sign) * 1e6; // as fast as the share allows
    const motion = { [of]: numbers, share: Number(document.getElementById("jog-share").value) };
    held = { button, motion, pointer, press: ++press, since: performance.now() };
    button.classList.add("held");
    say();
  };
  setInterval(say, HOLD);
  rcm.changed(() => show(rcm));
  pressed(hold);
  letGo(rcm);
}

function pressed(hold) {
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
}

function letGo(rcm) {
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
}

function show(rcm) {
  for (const button of document.querySelectorAll(".jog")) {
    button.disabled = !(rcm.may() && FROM.includes(rcm.board.phase));
  }
  if (held === null) return;
  const never = performance.now() - held.since > BEGUN && rcm.board.phase !== "JOG";
  if (never || held.button.disabled) rcm.letGo();
}
