// Taught poses: teach the present pose under a name, go to a pose, delete a pose.
import ActionButton from "/rcmservo/widgets/action_button.js";
import { can, rcm, view } from "/rcmservo/connection.js";

const CONFIRMATION_MS = 3000;

export default {
  components: { ActionButton },
  props: { maxLength: Number },
  data: () => ({ name: "", toConfirm: "" }),
  computed: {
    trimmed() { return this.name.trim(); },
    exists() { return (view.board.poses || []).includes(this.trimmed); },
    // Usable poses, then poses whose files this rig refuses, with the reason.
    poses: () => [
      ...(view.board.poses || []).map((name) => ({ name })),
      ...Object.entries(view.board.refused_poses || {}).map(([name, reason]) => ({ name, reason })),
    ],
  },
  setup: () => ({ can, rcm, view }),
  methods: {
    picture: (name) =>
      rcm.url(`/pose?name=${encodeURIComponent(name)}&version=${view.board.pose_version}`),
    // Deletion cannot be undone, so that it needs a second press.
    remove(name) {
      if (this.toConfirm === name) rcm.request("delete", { name });
      this.toConfirm = this.toConfirm === name ? "" : name;
      setTimeout(() => { if (this.toConfirm === name) this.toConfirm = ""; }, CONFIRMATION_MS);
    },
  },
  template: `
    <div class="rcm-widget">
      <div class="text-sm">Poses: name and teach the present pose</div>
      <div class="nicegui-row row items-center rcm-tight">
        <input id="name" class="rcm-field" aria-label="Name of the pose" :maxlength="maxLength"
          placeholder="name" v-model="name">
        <action-button name="Teach" action="teach" icon="add_location" :more="{ name: trimmed }"
          :label="exists ? 'Overwrite' : 'Teach'" tooltip="store the present observation">
        </action-button>
      </div>
      <div id="poses">
        <div class="pose" v-for="{ name, reason } in poses" :key="view.board.pose_version + name">
          <img alt="" :src="picture(name)" @error="$event.target.style.display = 'none'">
          <span v-if="reason">{{ name }}: {{ reason }}</span>
          <button v-else type="button" class="rcm-button go" :disabled="!can('go')"
            :aria-label="'Go ' + name" @click="rcm.request('go', { name })">Go {{ name }}</button>
          <button type="button" class="rcm-button delete" :disabled="!view.mayOperate"
            :aria-label="'Delete ' + name" @click="remove(name)"
            >{{ toConfirm === name ? "delete?" : "×" }}</button>
        </div>
      </div>
    </div>`,
};
