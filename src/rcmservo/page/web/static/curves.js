// Curves of the last half minute. They are asked for and drawn only while they are looked at.
import { charts, options } from "./charts.js";
import { made } from "./made.js";

const EVERY = 300, KEPT = 30; // ms, s

let count = 0, samples = [], truth = [];

export function start(rcm) {
  rcm.told((board) => {
    if (typeof board.truth_mm !== "number") return;
    const t = board.at * 1e-9;
    if (!truth.length || t - truth.at(-1)[0] > 0.1) truth.push([t, board.truth_mm]);
    truth = truth.filter(([at]) => at > t - KEPT);
  });
  const again = async () => {
    const chart = shown();
    if (chart) await ask(rcm).then(() => draw(chart), () => {});
    setTimeout(again, EVERY);
  };
  again();
}

// The chart, where it can be seen.
function shown() {
  const it = made(window.RCMSERVO.curves);
  const there = it?.chart && it.$el.offsetParent !== null && !document.hidden;
  return there ? it.chart : null;
}

async function ask(rcm) {
  const answer = await fetch(rcm.url(`/curves?after=${count}`));
  if (!answer.ok) throw new Error(answer.statusText);
  const told = await answer.json();
  if (told.count < count) samples = []; // another server
  count = told.count;
  const named = told.samples.map((numbers) =>
    Object.fromEntries(told.names.map((name, i) => [name, numbers[i]])));
  samples = [...samples, ...named];
  const end = samples.length ? samples.at(-1).t : 0;
  samples = samples.filter(({ t }) => t > end - KEPT);
}

function draw(chart) {
  const end = samples.length ? samples.at(-1).t : 0, ink = getComputedStyle(document.body).color;
  const parts = truth.length ? charts : charts.filter((one) => one.name !== "truth");
  const before = chart.getOption();
  if ((before?.grid || []).length !== parts.length || before.textStyle?.color !== ink) {
    chart.setOption(options(parts, ink), true);
  }
  const series = parts.flatMap((part) => part.lines.map((line) => ({
    data: part.name === "truth"
      ? truth.map(([t, mm]) => [t - end, mm])
      : samples.map((sample) => [sample.t - end, shownAs(sample[line.of], part)]),
  })));
  chart.setOption({ series });
}

const shownAs = (value, { scale, log }) =>
  value === null || (log && value <= 0) ? null : value * (scale || 1);
