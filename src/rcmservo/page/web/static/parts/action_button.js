// A button that asks the server for something, as long as the server may be asked for it.
import { can, rcm, view } from "/rcmservo/wire.js";

export default {
  props: { name: String, does: String, icon: String, words: String, label: String, more: Object },
  setup: () => ({ can, rcm, view }),
  template: `
    <q-btn dense color="primary" :icon="icon" :label="label || name" :aria-label="name"
      :data-do="does" :class="{ way: (view.board.ways || []).includes(does) }"
      :disable="!can(does)" @click="rcm.want(does, more)">
      <q-tooltip>{{ words }}</q-tooltip>
    </q-btn>`,
};
