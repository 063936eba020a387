// Past runs: the list, and one opened, with its replay, its figures and its files.
import { paint } from "./picture.js";

const AGAIN = 5000; // ms between looks at the list
const GREY = "#8a8a8a";
const TITLES = {
  timeline: "Time line", errors: "Feature errors", path: "Path", estimate: "Estimate",
};

let shown = "", playing = 0;

export function start(rcm) {
  const look = () => { if (room()?.offsetParent && !shown) list(rcm); };
  setInterval(look, AGAIN);
  document.addEventListener("click", () => setTimeout(() => {
    if (room()?.offsetParent && !room().childElementCount) look();
  }, 50));
  setTimeout(look, 500);
}

const room = () => document.getElementById("runs");

function made(name, attributes = {}, ...inside) {
  const one = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "onclick" || key === "oninput") one[key] = value;
    else one.setAttribute(key, value);
  }
  one.append(...inside);
  return one;
}

function fill(...inside) {
  const back = document.activeElement?.dataset?.run;
  room().replaceChildren(...inside);
  if (back) room().querySelector(`[data-run="${back}"]`)?.focus();
}

// What the server answers; what it refuses is an error with its words.
async function asked(rcm, path) {
  const answer = await fetch(rcm.url(path), { cache: "no-store" });
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({}));
  throw new Error(typeof told.detail === "string" ? told.detail : "the server cannot answer");
}

const alert = (error) => made("p", { role: "alert", class: "run-alert" }, error.message);

async function list(rcm) {
  try {
    const runs = await (await asked(rcm, "/runs")).json();
    if (!shown) fill(runs.length ? table(rcm, runs) : made("p", {}, "There are no runs yet."));
  } catch (error) {
    if (!shown) fill(alert(error));
  }
}

function table(rcm, runs) {
  const heads = ["When", "Length", "What", "How it ended", ""];
  const rows = runs.map((run) => made("tr", run.recording ? { class: "run-now" } : {},
    made("td", {}, run.when), made("td", {}, length(run.seconds)),
    made("td", {}, run.what, made("small", {}, run.folder)), made("td", {}, run.ended),
    made("td", {}, run.seconds === null ? "" : opener(rcm, run))));
  return made("table", { class: "run-list", "aria-label": "Past runs" },
    made("thead", {}, made("tr", {}, ...heads.map((one) => made("th", { scope: "col" }, one)))),
    made("tbody", {}, ...rows));
}

const opener = (rcm, run) => made("button", {
  type: "button", class: "run-button", "data-run": run.name,
  "aria-label": `Open ${run.folder}`, onclick: () => open(rcm, run),
}, "Open");

function length(seconds) {
  if (seconds === null) return "";
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  return `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`;
}

async function open(rcm, run) {
  shown = run.name;
  const back = made("button", { type: "button", class: "run-button", onclick: () => close(rcm) },
    "Back to the list");
  const title = made("strong", {}, `Past run ${run.folder}, ${run.when}`);
  const head = made("div", { class: "run-head" }, back, title);
  fill(head, made("p", { role: "status" }, "The record is being read …"));
  back.focus();
  const here = () => shown === run.name && head.isConnected;
  try {
    const told = await (await asked(rcm, `/runs/${run.name}`)).json();
    if (!here()) return;
    fill(head, downloads(rcm, run), replay(rcm, run, told), words(told), figures(rcm, run, told));
  } catch (error) {
    if (here()) fill(head, downloads(rcm, run), alert(error));
  }
}

function close(rcm) {
  shown = "";
  clearTimeout(playing);
  fill();
  list(rcm);
}

const link = (rcm, path, name, words) =>
  made("a", { href: rcm.url(path), download: name, class: "run-button" }, words);

const downloads = (rcm, run) => made("div", { class: "run-head" },
  link(rcm, `/runs/${run.name}/record.mcap`, "", "Download the record (MCAP)"));

function words(told) {
  const rows = [["verdict", told.verdict], ...told.summary];
  if (told.missing) rows.unshift(["missing", told.missing]);
  const summary = made("table", { class: "run-list", "aria-label": "Summary" }, ...rows.map(
    ([name, text]) => made("tr", {}, made("th", { scope: "row" }, name), made("td", {}, text))));
  const heads = ["Start", "Length", "Phase", "Why", "Way out"];
  const lines = told.spans.map(([start, long, phase, why, out]) => made("tr", {},
    ...[`${start.toFixed(2)} s`, `${long.toFixed(2)} s`, phase, why, out].map(
      (one) => made("td", {}, one))));
  const timeline = made("table", { class: "run-list", "aria-label": "Time line" },
    made("tr", {}, ...heads.map((one) => made("th", { scope: "col" }, one))), ...lines);
  return made("div", {}, summary, made("div", { class: "run-lines" }, timeline));
}

function figures(rcm, run, told) {
  return made("div", { class: "run-figures" }, ...told.figures.map((name) => {
    const path = `/runs/${run.name}/figures/${name}`, title = TITLES[name] || name;
    const image = made("img", { src: rcm.url(`${path}.svg`), alt: `Figure: ${title}` });
    const kinds = ["svg", "png"].map((kind) =>
      link(rcm, `${path}.${kind}`, "", `${title} as ${kind.toUpperCase()}`));
    return made("figure", {}, image, made("figcaption", { class: "run-head" }, ...kinds));
  }));
}

function replay(rcm, run, told) {
  const moments = told.moments;
  if (!moments.length) return made("p", {}, "The record holds no tick.");
  const canvas = made("canvas", { role: "img", "aria-label": "Picture of the past run" });
  const said = made("div", { class: "run-said" });
  const slider = made("input", { type: "range", min: 0, max: moments.length - 1, step: 1, value: 0,
    "aria-label": "Time in the past run", oninput: () => show(Number(slider.value)) });
  const play = made("button", { type: "button", class: "run-button", onclick: () => turn() },
    "Play");
  let wanted = 0, busy = false;

  async function show(i) {
    wanted = i;
    const moment = moments[i], [, , phase, why] = told.spans[moment.span] || [0, 0, "", ""];
    slider.value = i;
    const words = `${moment.t.toFixed(2)} s · ${[phase, why].filter(Boolean).join(" · ")}`;
    said.textContent = words;
    slider.setAttribute("aria-valuetext", words);
    if (busy) return;
    busy = true;
    try {
      for (let at = -1; at !== wanted;) { // the newest that is wanted, none of those between
        at = wanted;
        await draw(moments[at]);
      }
    } catch (error) {
      said.textContent = error.message;
    } finally {
      busy = false;
    }
  }

  async function draw(moment) {
    const board = { points: moment.points, rcm: moment.rcm, target: told.targets[moment.stage] };
    const image = moment.picture < 0 ? blank(told.size) : await createImageBitmap(
      await (await asked(rcm, `/runs/${run.name}/pictures/${moment.picture}`)).blob());
    paint(canvas, image, board);
    if (image.close) image.close();
  }

  function turn() {
    const going = play.textContent === "Play";
    play.textContent = going ? "Hold still" : "Play";
    clearTimeout(playing);
    if (!going) return;
    const last = moments.length - 1, from = wanted >= last ? 0 : wanted;
    const began = performance.now() - 1000 * moments[from].t;
    let i = from;
    const step = () => {
      if (!canvas.isConnected) return;
      const t = (performance.now() - began) / 1000;
      while (i < last && moments[i + 1].t <= t) i += 1;
      if (i !== wanted || i === from) show(i);
      if (i < last) playing = setTimeout(step, 50);
      else play.textContent = "Play";
    };
    step();
  }

  show(0);
  return made("div", { class: "run-replay" }, made("div", { class: "run-banner" },
    "Replay of the past: the live picture is above"), canvas,
    made("div", { class: "run-head" }, play, slider), said);
}

function blank([width, height]) {
  const sheet = new OffscreenCanvas(width, height);
  const pen = sheet.getContext("2d");
  pen.fillStyle = GREY;
  pen.fillRect(0, 0, width, height);
  return sheet;
}
