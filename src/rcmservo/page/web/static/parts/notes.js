// What was said lately.
import { view } from "/rcmservo/wire.js";

export default {
  computed: { words: () => [...(view.board.notes || []), view.refused].filter(Boolean).join("\n") },
  template: `
    <div class="rcm-part"><div id="notes" role="log" aria-label="Notes">{{ words }}</div></div>`,
};
