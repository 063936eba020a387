// Newest notes of the servo, and the reason of the last refused request.
import { view } from "/rcmservo/connection.js";

export default {
  computed: { text: () => [...(view.board.notes || []), view.refusal].filter(Boolean).join("\n") },
  template: `
    <div class="rcm-widget"><div id="notes" role="log" aria-label="Notes">{{ text }}</div></div>`,
};
