// A tour: a list of poses is made here and sent as a whole; how far it is comes with the board.
import { can, rcm, view } from "/rcmservo/wire.js";

export default {
  props: { most: Number, longest: Number, laps: Number },
  data: () => ({ stops: [], pose: "", dwell: 5, rounds: 1 }),
  computed: {
    poses: () => view.board.poses || [],
    tour: () => view.board.tour || null,
    chosen() { return this.poses.includes(this.pose) ? this.pose : this.poses[0]; },
    room() { return this.chosen !== undefined && this.stops.length < this.most; },
    words() {
      if (!this.tour) return "";
      const { pose, stop, stops, lap, laps, left } = this.tour;
      const where = left === null ? `on the way to ${pose}` : `at ${pose}, ${left} s left`;
      return `Tour: ${where} (pose ${stop} of ${stops}, round ${lap} of ${laps})`;
    },
  },
  setup: () => ({ can, rcm, view }),
  methods: {
    add() {
      const { chosen: pose, dwell } = this;
      if (Number.isFinite(dwell)) this.stops.push({ pose, dwell });
    },
    earlier(at) {
      if (at > 0) this.stops.splice(at - 1, 2, this.stops[at], this.stops[at - 1]);
    },
  },
  template: `
    <div class="rcm-part">
      <details id="tour">
        <summary>Tour: visit poses in turn</summary>
        <ol id="tour-stops" aria-label="Poses of the tour">
          <li v-for="({ pose, dwell }, at) in stops"
            :aria-current="tour && tour.stop === at + 1 ? 'step' : null">
            <span>{{ pose }}, {{ dwell }} s</span>
            <button type="button" class="rcm-button" :aria-label="'Move ' + pose + ' up'"
              @click="earlier(at)">↑</button>
            <button type="button" class="rcm-button" :aria-label="'Take ' + pose + ' off the tour'"
              @click="stops.splice(at, 1)">×</button>
          </li>
        </ol>
        <div class="tour-row">
          <select id="tour-pose" class="rcm-field" aria-label="Pose to visit" :value="chosen"
            @change="pose = $event.target.value">
            <option v-for="one in poses">{{ one }}</option>
          </select>
          <label>for <input id="tour-dwell" class="rcm-field" type="number" min="0" :max="longest"
            step="any" aria-label="Dwell in seconds" v-model.number="dwell"> s</label>
          <button type="button" class="rcm-button" :disabled="!room" @click="add">Add</button>
        </div>
        <div class="tour-row">
          <label>rounds <input id="tour-rounds" class="rcm-field" type="number" min="1" :max="laps"
            step="1" aria-label="Rounds" v-model.number="rounds"></label>
          <button type="button" class="rcm-button" aria-label="Start the tour"
            :disabled="!can('go') || tour !== null || stops.length === 0"
            @click="rcm.want('tour', { stops, rounds })">Start</button>
          <button type="button" class="rcm-button" aria-label="End the tour"
            :disabled="!view.may || tour === null" @click="rcm.want('pause')">End</button>
        </div>
      </details>
      <div id="tour-progress">{{ words }}</div>
    </div>`,
};
