// Who has control, the buttons that hand it over, and STOP, which is always in sight.
import ActionButton from "/rcmservo/parts/action_button.js";
import { view } from "/rcmservo/wire.js";

export default {
  components: { ActionButton },
  setup: () => ({ view }),
  template: `
    <div class="nicegui-row row items-center">
      <span id="control" role="status">{{
        view.holds ? "you have control" + (view.asked ? "; another browser asks for it" : "")
          : "you watch" }}</span>
      <action-button name="Take control" does="ask" icon="how_to_reg"
        words="move the arm from this browser"></action-button>
      <action-button name="Hand over" does="give" icon="swap_horiz"
        words="to the browser that asks"></action-button>
      <button id="stop" type="button" :class="{ deaf: !view.stopReady }" aria-label="STOP"
        title="A software stop, also on the space bar: it switches the drive off. The emergency \
stop of the arm is another one, and comes first."
        >STOP<small>software stop · space bar</small></button>
    </div>`,
};
