// A tour: a list of poses is made here and sent as a whole; how far it is comes with the board.
const $ = (id) => document.getElementById(id);
const WAITING = ["OFF", "FAULT"];
const STOPS = 20;
let stops = [], drawn = null, offered = null;

const DOES = {
  add() {
    const pose = $("tour-pose").value, dwell = $("tour-dwell").valueAsNumber;
    if (pose && Number.isFinite(dwell) && stops.length < STOPS) stops.push({ pose, dwell });
  },
  earlier(at) { if (at > 0) stops.splice(at - 1, 2, stops[at], stops[at - 1]); },
  remove(at) { stops.splice(at, 1); },
  start(_, rcm) { rcm.want("tour", { stops, rounds: $("tour-rounds").valueAsNumber }); },
  end(_, rcm) { rcm.want("pause"); },
};

export function start(rcm) {
  document.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("[data-tour]") : null;
    if (!button || button.disabled) return;
    DOES[button.dataset.tour](Number(button.dataset.at), rcm);
    show(rcm);
  });
  rcm.changed(() => show(rcm));
}

function show(rcm) {
  if (!$("tour")) return;
  const { tour, phase, poses = [] } = rcm.board;
  offer(poses);
  list(tour);
  const can = { add: poses.length > 0 && stops.length < STOPS,
    start: rcm.may() && !WAITING.includes(phase) && !tour && stops.length > 0,
    end: rcm.may() && Boolean(tour) };
  for (const [what, may] of Object.entries(can)) {
    document.querySelector(`[data-tour="${what}"]`).disabled = !may;
  }
  $("tour-progress").textContent = tour ? words(tour) : "";
}

function words({ pose, stop, stops, lap, laps, left }) {
  const where = left === null ? `on the way to ${pose}` : `at ${pose}, ${left} s left`;
  return `Tour: ${where} (pose ${stop} of ${stops}, round ${lap} of ${laps})`;
}

function offer(poses) {
  const key = JSON.stringify(poses);
  if (key === offered) return;
  offered = key;
  const chosen = $("tour-pose").value;
  $("tour-pose").replaceChildren(...poses.map((pose) => new Option(pose, pose)));
  if (poses.includes(chosen)) $("tour-pose").value = chosen;
}

function list(tour) {
  const key = JSON.stringify([stops, tour ? tour.stop : null]);
  if (key === drawn) return;
  drawn = key;
  $("tour-stops").replaceChildren(...stops.map((one, at) => {
    const row = document.createElement("li"), name = document.createElement("span");
    name.textContent = `${one.pose}, ${one.dwell} s`;
    if (tour && tour.stop === at + 1) row.setAttribute("aria-current", "step");
    row.append(name, button("earlier", at, "↑", `Move ${one.pose} up`),
      button("remove", at, "×", `Take ${one.pose} off the tour`));
    return row;
  }));
}

function button(what, at, shown, called) {
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.tour = what;
  button.dataset.at = at;
  button.textContent = shown;
  button.setAttribute("aria-label", called);
  return button;
}
