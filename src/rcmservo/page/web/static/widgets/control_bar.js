// Bar in the header: who has control of the arm, the buttons that transfer it, and STOP.
import ActionButton from "/rcmservo/widgets/action_button.js";
import { view } from "/rcmservo/connection.js";

export default {
  components: { ActionButton },
  computed: {
    ownership: () => {
      if (!view.hasControl) return "you are watching";
      return `you have control${view.isControlRequested ? "; another browser requests it" : ""}`;
    },
  },
  setup: () => ({ view }),
  template: `
    <div class="nicegui-row row items-center">
      <span id="control" role="status">{{ ownership }}</span>
      <action-button name="Take control" action="request_control" icon="how_to_reg"
        tooltip="operate the arm from this browser"></action-button>
      <action-button name="Hand over" action="hand_over" icon="swap_horiz"
        tooltip="transfer control to the browser that requests it"></action-button>
      <button id="stop" type="button" :class="{ disconnected: !view.isStopConnected }"
        aria-label="STOP" title="Software stop, also on the space bar: it switches the drive off. \
The emergency stop of the arm is independent of it and comes first."
        >STOP<small>software stop · space bar</small></button>
    </div>`,
};
