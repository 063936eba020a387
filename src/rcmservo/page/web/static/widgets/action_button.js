// Button that requests an action from the server. It is enabled while the action is allowed.
import { can, rcm, view } from "/rcmservo/connection.js";

export default {
  props: { name: String, action: String, icon: String, tooltip: String, label: String,
    more: Object },
  setup: () => ({ can, rcm, view }),
  template: `
    <q-btn dense color="primary" :icon="icon" :label="label || name" :aria-label="name"
      :data-do="action" :class="{ recovery: (view.board.recovery || []).includes(action) }"
      :disable="!can(action)" @click="rcm.request(action, more)">
      <q-tooltip>{{ tooltip }}</q-tooltip>
    </q-btn>`,
};
