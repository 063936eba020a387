// State of the servo in words and colour, and the question that the operator must answer.
import { rcm, view } from "/rcmservo/connection.js";

const STOP_DISCONNECTED = "STOP is not connected: use the emergency stop of the arm";

function describeErrors({ moves, delta, truth_mm: truth }) {
  if (!moves) return "";
  if (!Array.isArray(delta) || delta.includes(null)) return "exploring";
  const [s, r, d] = delta;
  const trueError = truth == null ? "" : `  true error ${truth.toFixed(2)} mm`;
  const degrees = (s * 180 / Math.PI).toFixed(2);
  return `Δs ${degrees}°  Δr ${r.toFixed(1)} px  Δd ${d.toFixed(1)} px${trueError}`;
}

export default {
  props: { maxLength: Number },
  data: () => ({ answer: "" }),
  computed: {
    board: () => (view.isConnected ? view.board : {}),
    stopAlert: () => view.stopStatus || (view.isStopConnected ? "" : STOP_DISCONNECTED),
  },
  setup: () => ({ view, describeErrors }),
  methods: {
    sendAnswer() {
      rcm.request("answer", { question: view.board.question, words: this.answer });
      this.answer = "";
    },
  },
  template: `
    <div class="rcm-widget">
      <div id="state" role="status" aria-live="polite" :class="{ lost: !view.isConnected }"
        :data-phase="board.phase" :data-action="board.action">
        <div id="phase">{{ view.isConnected ? board.words : "no connection to the server" }}</div>
        <div id="why">{{ board.why }}</div>
        <div id="way-out">{{ board.way_out ? "→ " + board.way_out : "" }}</div>
        <div id="errors">{{ describeErrors(board) }}</div>
      </div>
      <div id="estimator-status">{{ board.estimator_status }}</div>
      <div id="stop-alert" role="alert">{{ stopAlert }}</div>
      <div id="intent" v-if="board.intent">{{ board.intent }}</div>
      <form id="prompt" v-if="board.question" @submit.prevent="sendAnswer">
        <label for="answer" id="question">{{ board.question }}</label>
        <input id="answer" class="rcm-field" type="text" :maxlength="maxLength" autocomplete="off"
          v-model="answer">
        <button class="rcm-button" type="submit" :disabled="!view.mayOperate" aria-label="Answer"
          data-do="answer">Answer</button>
      </form>
    </div>`,
};
