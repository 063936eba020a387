// Charts of the tab "Curves" and their options for ECharts. The colours of Okabe and Ito suit
// colour-blind readers; predicted curves are dashed or dotted.
const BLUE = "#0072b2", ORANGE = "#e69f00", GREEN = "#009e73", RED = "#d55e00";
const DEGREES = 180 / Math.PI, COLUMNS = 2, CHART_HEIGHT_PX = 11.2 * 16; // 11.2 rem

const line = (name, field, colour, type = "solid") => ({ name, field, colour, type });

// `field` of a line is its name in SAMPLE_FIELDS of page/plots/curves.py; `scale` converts the
// server's unit to `unit`.
export const charts = [
  { name: "Error of the angle", unit: "°", scale: DEGREES, lines: [line("Δs", "delta_s", BLUE)] },
  { name: "Errors of the distances", unit: "px",
    lines: [line("Δr", "delta_r", BLUE), line("Δd", "delta_d", ORANGE)] },
  { name: "Rate of s", unit: "°/s", scale: DEGREES, lines: [
    line("s measured", "measured_s", BLUE), line("s predicted", "predicted_s", RED, "dashed")] },
  { name: "Rates of r and d", unit: "px/s", lines: [
    line("r measured", "measured_r", BLUE), line("r predicted", "predicted_r", RED, "dashed"),
    line("d measured", "measured_d", ORANGE),
    line("d predicted", "predicted_d", GREEN, "dotted")] },
  { name: "Speed ‖v‖", unit: "mm/s", lines: [line("‖v‖", "speed", BLUE)] },
  { name: "Condition of Ĵ", unit: "1", log: true, lines: [line("condition", "condition", BLUE)] },
  { name: "Largest lateness of the loop", unit: "ms", lines: [line("lateness", "late", BLUE)] },
  { name: "True error", unit: "mm", simulated: true,
    lines: [line("true pose error (simulation only)", "", GREEN)] },
];

// Return ECharts' options that place `shownCharts` in a grid; `ink` is the colour of the text.
export function chartOptions(shownCharts, ink) {
  const faint = "rgba(128, 128, 128, 0.35)", widthPercent = 100 / COLUMNS;
  const left = (k) => (k % COLUMNS) * widthPercent;
  const top = (k) => Math.floor(k / COLUMNS) * CHART_HEIGHT_PX;
  const axis = { axisLabel: { color: ink }, nameTextStyle: { color: ink } };
  const lines = shownCharts.flatMap((chart, k) => chart.lines.map((curve) => ({ ...curve, k })));
  return {
    animation: false,
    textStyle: { color: ink },
    title: shownCharts.map((chart, k) => ({
      text: `${chart.name} [${chart.unit}]`,
      left: `${left(k) + 1}%`, top: top(k), textStyle: { color: ink, fontSize: 12 },
    })),
    legend: shownCharts.map((chart, k) => ({
      data: chart.lines.map(({ name }) => name), left: `${left(k) + 1}%`, top: top(k) + 15,
      textStyle: { color: ink, fontSize: 10 }, itemWidth: 18, itemHeight: 8, selectedMode: false,
      width: `${widthPercent - 2}%`, itemGap: 6,
    })),
    grid: shownCharts.map((chart, k) => ({
      left: `${left(k) + 6}%`, width: `${widthPercent - 9}%`, top: top(k) + 42,
      height: CHART_HEIGHT_PX - 80,
    })),
    xAxis: shownCharts.map((chart, k) => ({
      ...axis, gridIndex: k, min: -30, max: 0, interval: 10,
      axisLabel: { color: ink, formatter: (t) => (t === 0 ? "0 s" : t) },
      splitLine: { show: false },
    })),
    yAxis: shownCharts.map((chart, k) => ({
      ...axis, gridIndex: k, type: chart.log ? "log" : "value", scale: false, splitNumber: 3,
      splitLine: { lineStyle: { color: faint } },
    })),
    series: lines.map(({ name, colour, type, k }) => ({
      type: "line", name, xAxisIndex: k, yAxisIndex: k, showSymbol: false, data: [],
      lineStyle: { color: colour, type, width: 2 }, itemStyle: { color: colour },
    })),
  };
}
