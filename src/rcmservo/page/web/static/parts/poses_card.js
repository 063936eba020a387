// Poses: name the present one and teach it, go to one, delete one.
import ActionButton from "/rcmservo/parts/action_button.js";
import { can, rcm, view } from "/rcmservo/wire.js";

const SURE = 3000; // ms

export default {
  components: { ActionButton },
  props: { longest: Number },
  data: () => ({ name: "", asked: "" }),
  computed: {
    called() { return this.name.trim(); },
    known() { return (view.board.poses || []).includes(this.called); },
    // Each pose with what was seen as it was taught; one that this rig refuses, with the reason.
    poses: () => [
      ...(view.board.poses || []).map((name) => ({ name })),
      ...Object.entries(view.board.refused_poses || {}).map(([name, why]) => ({ name, why })),
    ],
  },
  setup: () => ({ can, rcm, view }),
  methods: {
    picture: (name) => rcm.url(`/pose?name=${encodeURIComponent(name)}&kept=${view.board.kept}`),
    // What cannot be undone is done at the second press.
    remove(name) {
      if (this.asked === name) rcm.want("delete", { name });
      this.asked = this.asked === name ? "" : name;
      setTimeout(() => { if (this.asked === name) this.asked = ""; }, SURE);
    },
  },
  template: `
    <div class="rcm-part">
      <div class="nicegui-row row items-center rcm-tight">
        <input id="name" class="rcm-field" aria-label="Name of the pose" :maxlength="longest"
          placeholder="name" v-model="name">
        <action-button name="Teach" does="teach" icon="add_location" :more="{ name: called }"
          :label="known ? 'Overwrite' : 'Teach'" words="keep what the camera sees now">
        </action-button>
      </div>
      <div id="poses">
        <div class="pose" v-for="{ name, why } in poses" :key="view.board.kept + name">
          <img alt="" :src="picture(name)" @error="$event.target.style.display = 'none'">
          <span v-if="why">{{ name }}: {{ why }}</span>
          <button v-else type="button" class="rcm-button go" :disabled="!can('go')"
            :aria-label="'Go ' + name" @click="rcm.want('go', { name })">Go {{ name }}</button>
          <button type="button" class="rcm-button delete" :disabled="!view.may"
            :aria-label="'Delete ' + name" @click="remove(name)"
            >{{ asked === name ? "sure?" : "×" }}</button>
        </div>
      </div>
    </div>`,
};
