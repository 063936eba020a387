// Owner of control, the buttons that transfer it, and STOP, which is always visible.
import ActionButton from "/rcmservo/parts/action_button.js";
import { view } from "/rcmservo/connection.js";

export default {
  components: { ActionButton },
  setup: () => ({ view }),
  template: `
    <div class="nicegui-row row items-center">
      <span id="control" role="status">{{
        view.holds ? "you have control" + (view.requested ? "; another browser requests it" : "")
          : "you are watching" }}</span>
      <action-button name="Take control" action="request_control" icon="how_to_reg"
        tooltip="operate the arm from this browser"></action-button>
      <action-button name="Hand over" action="hand_over" icon="swap_horiz"
        tooltip="transfer control to the browser that requests it"></action-button>
      <button id="stop" type="button" :class="{ disconnected: !view.stopReady }" aria-label="STOP"
        title="Software stop, also on the space bar: it switches the drive off. The emergency stop \
of the arm is independent of it and comes first."
        >STOP<small>software stop · space bar</small></button>
    </div>`,
};
