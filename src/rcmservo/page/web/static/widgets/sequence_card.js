// Editor of a pose sequence, which is sent as a whole, and its progress, which the board reports.
import { can, rcm, view } from "/rcmservo/connection.js";

export default {
  props: { maxWaypoints: Number, maxDwell: Number, maxRounds: Number },
  data: () => ({ waypoints: [], pose: "", dwell: 5, rounds: 1 }),
  computed: {
    poses: () => view.board.poses || [],
    progress: () => view.board.sequence || null,
    selected() { return this.poses.includes(this.pose) ? this.pose : this.poses[0]; },
    canAdd() { return this.selected !== undefined && this.waypoints.length < this.maxWaypoints; },
    text() {
      if (!this.progress) return "";
      const { pose, waypoint_number: number, waypoints, round_number: round, rounds,
        remaining_s: remaining } = this.progress;
      const state = remaining === null ? `moving to ${pose}` : `at ${pose}, ${remaining} s left`;
      return `Sequence: ${state} (pose ${number} of ${waypoints}, round ${round} of ${rounds})`;
    },
  },
  setup: () => ({ can, rcm, view }),
  methods: {
    add() {
      const { selected: pose, dwell } = this;
      if (Number.isFinite(dwell)) this.waypoints.push({ pose, dwell });
    },
    moveUp(i) {
      if (i > 0) this.waypoints.splice(i - 1, 2, this.waypoints[i], this.waypoints[i - 1]);
    },
  },
  template: `
    <div class="rcm-widget">
      <details id="sequence">
        <summary>Sequence: visit poses in turn</summary>
        <ol id="waypoints" aria-label="Poses of the sequence">
          <li v-for="({ pose, dwell }, i) in waypoints"
            :aria-current="progress && progress.waypoint_number === i + 1 ? 'step' : null">
            <span>{{ pose }}, {{ dwell }} s</span>
            <button type="button" class="rcm-button" :aria-label="'Move ' + pose + ' up'"
              @click="moveUp(i)">↑</button>
            <button type="button" class="rcm-button"
              :aria-label="'Remove ' + pose + ' from the sequence'"
              @click="waypoints.splice(i, 1)">×</button>
          </li>
        </ol>
        <div class="sequence-row">
          <select id="waypoint-pose" class="rcm-field" aria-label="Pose to visit" :value="selected"
            @change="pose = $event.target.value">
            <option v-for="name in poses">{{ name }}</option>
          </select>
          <label>for <input id="dwell" class="rcm-field" type="number" min="0" :max="maxDwell"
            step="any" aria-label="Dwell in seconds" v-model.number="dwell"> s</label>
          <button type="button" class="rcm-button" :disabled="!canAdd" @click="add">Add</button>
        </div>
        <div class="sequence-row">
          <label>rounds <input id="rounds" class="rcm-field" type="number" min="1"
            :max="maxRounds" step="1" aria-label="Rounds" v-model.number="rounds"></label>
          <button type="button" class="rcm-button" aria-label="Start the sequence"
            :disabled="!can('go') || progress !== null || waypoints.length === 0"
            @click="rcm.request('sequence', { waypoints, rounds })">Start</button>
          <button type="button" class="rcm-button" aria-label="End the sequence"
            :disabled="!view.mayOperate || progress === null" @click="rcm.request('pause')"
            >End</button>
        </div>
      </details>
      <div id="sequence-progress">{{ text }}</div>
    </div>`,
};
