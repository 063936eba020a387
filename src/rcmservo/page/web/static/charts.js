// Which curves there are, and how they look: Okabe and Ito's colours, and a line of its own kind
// for what is only predicted.
const BLUE = "#0072b2", ORANGE = "#e69f00", GREEN = "#009e73", RED = "#d55e00";
const DEGREES = 180 / Math.PI, COLUMNS = 2, HEIGHT = 11.2; // rem of a chart

const line = (name, of, colour, type = "solid") => ({ name, of, colour, type });

export const charts = [
  { name: "Error of the angle", unit: "°", scale: DEGREES, lines: [line("Δs", "delta_s", BLUE)] },
  { name: "Errors of the distances", unit: "px",
    lines: [line("Δr", "delta_r", BLUE), line("Δd", "delta_d", ORANGE)] },
  { name: "Rate of s", unit: "°/s", scale: DEGREES, lines: [
    line("s measured", "measured_s", BLUE), line("s predicted", "predicted_s", RED, "dashed")] },
  { name: "Rates of r and d", unit: "px/s", lines: [
    line("r measured", "measured_r", BLUE), line("r predicted", "predicted_r", RED, "dashed"),
    line("d measured", "measured_d", ORANGE), line("d predicted", "predicted_d", GREEN, "dotted")] },
  { name: "Speed ‖v‖", unit: "mm/s", lines: [line("‖v‖", "speed", BLUE)] },
  { name: "Condition of Ĵ", unit: "1", log: true, lines: [line("condition", "condition", BLUE)] },
  { name: "Loop late by, at worst", unit: "ms", lines: [line("late", "late", BLUE)] },
  { name: "truth", unit: "mm",
    lines: [line("true pose error (simulation only)", "truth", GREEN)] },
];

export function options(parts, ink) {
  const faint = "rgba(128, 128, 128, 0.35)", wide = 100 / COLUMNS;
  const left = (k) => (k % COLUMNS) * wide, top = (k) => Math.floor(k / COLUMNS) * HEIGHT * 16;
  const axis = { axisLabel: { color: ink }, nameTextStyle: { color: ink } };
  const lines = parts.flatMap((part, k) => part.lines.map((one) => ({ ...one, k })));
  return {
    animation: false,
    textStyle: { color: ink },
    title: parts.map((part, k) => ({
      text: `${part.name === "truth" ? "Truth" : part.name} [${part.unit}]`,
      left: `${left(k) + 1}%`, top: top(k), textStyle: { color: ink, fontSize: 12 },
    })),
    legend: parts.map((part, k) => ({
      data: part.lines.map(({ name }) => name), left: `${left(k) + 1}%`, top: top(k) + 15,
      textStyle: { color: ink, fontSize: 10 }, itemWidth: 18, itemHeight: 8, selectedMode: false,
      width: `${wide - 2}%`, itemGap: 6,
    })),
    grid: parts.map((part, k) => ({
      left: `${left(k) + 6}%`, width: `${wide - 9}%`, top: top(k) + 42, height: HEIGHT * 16 - 80,
    })),
    xAxis: parts.map((part, k) => ({
      ...axis, gridIndex: k, min: -30, max: 0, interval: 10,
      axisLabel: { color: ink, formatter: (t) => (t === 0 ? "0 s" : t) },
      splitLine: { show: false },
    })),
    yAxis: parts.map((part, k) => ({
      ...axis, gridIndex: k, type: part.log ? "log" : "value", scale: false, splitNumber: 3,
      splitLine: { lineStyle: { color: faint } },
    })),
    series: lines.map(({ name, colour, type, k }) => ({
      type: "line", name, xAxisIndex: k, yAxisIndex: k, showSymbol: false, data: [],
      lineStyle: { color: colour, type, width: 2 }, itemStyle: { color: colour },
    })),
  };
}
