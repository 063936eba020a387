// How the servo stands, in words and colour, and what a person is asked before it can go on.
import { rcm, view } from "/rcmservo/wire.js";

const DEAF = "STOP is not connected: use the emergency stop of the arm";

function errors({ moves, delta, truth_mm: truth }) {
  if (!moves) return "";
  if (!Array.isArray(delta) || delta.includes(null)) return "exploring";
  const [s, r, d] = delta, off = truth == null ? "" : `  truth: ${truth.toFixed(2)} mm off`;
  const degrees = (s * 180 / Math.PI).toFixed(2);
  return `Δs ${degrees}°  Δr ${r.toFixed(1)} px  Δd ${d.toFixed(1)} px${off}`;
}

export default {
  props: { longest: Number },
  data: () => ({ answer: "" }),
  computed: { board: () => (view.connected ? view.board : {}) },
  setup: () => ({ view, errors, DEAF }),
  methods: {
    reply() {
      rcm.want("answer", { question: view.board.asks, words: this.answer });
      this.answer = "";
    },
  },
  template: `
    <div class="rcm-part">
      <div id="state" role="status" aria-live="polite" :class="{ lost: !view.connected }"
        :data-phase="board.phase" :data-action="board.action">
        <div id="phase">{{ view.connected ? board.words : "no connection to the server" }}</div>
        <div id="why">{{ board.why }}</div>
        <div id="way">{{ board.way_out ? "→ " + board.way_out : "" }}</div>
        <div id="errors">{{ errors(board) }}</div>
      </div>
      <div id="standing">{{ board.standing }}</div>
      <div id="unheard" role="alert">{{ view.stopWords || (view.stopReady ? "" : DEAF) }}</div>
      <div id="intent" v-if="board.intent">{{ board.intent }}</div>
      <form id="asking" v-if="board.asks" @submit.prevent="reply">
        <label for="answer" id="question">{{ board.asks }}</label>
        <input id="answer" class="rcm-field" type="text" :maxlength="longest" autocomplete="off"
          v-model="answer">
        <button class="rcm-button" type="submit" :disabled="!view.may" aria-label="Answer"
          data-do="answer">Answer</button>
      </form>
    </div>`,
};
