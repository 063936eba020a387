// Chart of the curves of the last 30 s. They are fetched and drawn only while they are visible.
import { rcm } from "../connection.js";
import { charts, chartOptions } from "./chart_options.js";
import { findNiceguiElement } from "./nicegui_element.js";

const REFRESH_MS = 300, LENGTH_S = 30, TRUTH_PERIOD_S = 0.1;

let sampleCount = 0; // samples of the server since its start
let samples = []; // newest samples, objects with the server's field names
let trueErrors = []; // pairs of time in s and true pose error in mm; empty outside simulation

rcm.onBoard((board) => {
  if (typeof board.truth_mm !== "number") return;
  const now = board.at * 1e-9;
  if (!trueErrors.length || now - trueErrors.at(-1)[0] > TRUTH_PERIOD_S) {
    trueErrors.push([now, board.truth_mm]);
  }
  trueErrors = trueErrors.filter(([t]) => t > now - LENGTH_S);
});

async function refresh() {
  const chart = findVisibleChart();
  if (chart) await fetchSamples().then(() => drawCurves(chart), () => {});
  setTimeout(refresh, REFRESH_MS);
}
refresh();

function findVisibleChart() {
  const element = findNiceguiElement(window.RCMSERVO.curves);
  const isVisible = element?.chart && element.$el.offsetParent !== null && !document.hidden;
  return isVisible ? element.chart : null;
}

async function fetchSamples() {
  const response = await fetch(rcm.url(`/curves?after=${sampleCount}`));
  if (!response.ok) throw new Error(response.statusText);
  const { count, names, samples: rows } = await response.json();
  if (count < sampleCount) samples = []; // the server was restarted
  sampleCount = count;
  samples = [...samples, ...rows.map((numbers) =>
    Object.fromEntries(names.map((name, i) => [name, numbers[i]])))];
  samples = samples.filter(({ t }) => t > newestTime() - LENGTH_S);
}

const newestTime = () => (samples.length ? samples.at(-1).t : 0);

function drawCurves(chart) {
  const ink = getComputedStyle(document.body).color;
  const shownCharts = trueErrors.length ? charts : charts.filter(({ simulated }) => !simulated);
  const options = chart.getOption();
  if ((options?.grid || []).length !== shownCharts.length || options.textStyle?.color !== ink) {
    chart.setOption(chartOptions(shownCharts, ink), true);
  }
  const end = newestTime();
  const series = shownCharts.flatMap((shown) => shown.lines.map(({ field }) => ({
    data: shown.simulated
      ? trueErrors.map(([t, error_mm]) => [t - end, error_mm])
      : samples.map((sample) => [sample.t - end, toDisplayUnit(sample[field], shown)]),
  })));
  chart.setOption({ series });
}

const toDisplayUnit = (value, { scale, log }) =>
  value === null || (log && value <= 0) ? null : value * (scale || 1);
