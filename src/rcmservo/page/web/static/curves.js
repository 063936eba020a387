// Curves of the last 30 s. They are fetched and drawn only while they are visible.
import { charts, chartOptions } from "./charts.js";
import { niceguiElement } from "./nicegui_element.js";

const REFRESH_MS = 300, LENGTH_S = 30, TRUTH_PERIOD_S = 0.1;

let count = 0, samples = [], truth = [];

export function start(rcm) {
  rcm.onBoard((board) => {
    if (typeof board.truth_mm !== "number") return;
    const t = board.at * 1e-9;
    if (!truth.length || t - truth.at(-1)[0] > TRUTH_PERIOD_S) truth.push([t, board.truth_mm]);
    truth = truth.filter(([at]) => at > t - LENGTH_S);
  });
  const repeat = async () => {
    const chart = visibleChart();
    if (chart) await fetchSamples(rcm).then(() => draw(chart), () => {});
    setTimeout(repeat, REFRESH_MS);
  };
  repeat();
}

function visibleChart() {
  const element = niceguiElement(window.RCMSERVO.curves);
  const visible = element?.chart && element.$el.offsetParent !== null && !document.hidden;
  return visible ? element.chart : null;
}

async function fetchSamples(rcm) {
  const response = await fetch(rcm.url(`/curves?after=${count}`));
  if (!response.ok) throw new Error(response.statusText);
  const answer = await response.json();
  if (answer.count < count) samples = []; // the server was restarted
  count = answer.count;
  const named = answer.samples.map((numbers) =>
    Object.fromEntries(answer.names.map((name, i) => [name, numbers[i]])));
  samples = [...samples, ...named];
  const end = samples.length ? samples.at(-1).t : 0;
  samples = samples.filter(({ t }) => t > end - LENGTH_S);
}

function draw(chart) {
  const end = samples.length ? samples.at(-1).t : 0, ink = getComputedStyle(document.body).color;
  const selected = truth.length ? charts : charts.filter(({ simulated }) => !simulated);
  const before = chart.getOption();
  if ((before?.grid || []).length !== selected.length || before.textStyle?.color !== ink) {
    chart.setOption(chartOptions(selected, ink), true);
  }
  const series = selected.flatMap((one) => one.lines.map(({ field }) => ({
    data: one.simulated
      ? truth.map(([t, mm]) => [t - end, mm])
      : samples.map((sample) => [sample.t - end, toDisplayUnit(sample[field], one)]),
  })));
  chart.setOption({ series });
}

const toDisplayUnit = (value, { scale, log }) =>
  value === null || (log && value <= 0) ? null : value * (scale || 1);
