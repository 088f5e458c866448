// A pad's data: the scene, the last touches, and the last frames.

const TAXELS = 64;
const TOUCHES = 40;
const PAD_AT = 4 + 2 * TAXELS;
const FRAME_BYTES = PAD_AT + 1;
// A touch is detected a little after it began: its first frames are taken from this many recent ones.
const RECENT_FRAMES = 54;
const REST_FRAMES = 54;
// Four times the noise of the pad.
const NOISE_COUNTS = 3;
// The sum of counts from which the centroid of pressure is that of a hand.
const LIGHTEST_LOAD = 12;
// Share of the way to the centroid of pressure that the trail moves in a frame.
const FOLLOW = 0.3;

/** The index of a frame's pad. */
export const padOf = (buffer) => new DataView(buffer).getUint8(PAD_AT);

export class Store {
  scene = { labels: [], answer_at_frames: [], frame_rate_hz: 54, revise_margin: 0, model: "", robot_configured: false };
  sensor = null;
  robot = null;
  status = null;
  /** The robot's last words or action about the last touch. */
  action = null;
  touches = [];
  live = null;
  /** Numbers of the touches about which the robot was told while it was up. */
  reported = new Set();
  /** The labels of touches, by their numbers. */
  said = new Map();
  /** Where the hand was in the last second: the sensor's clock, row and column, null where nothing pressed. */
  trail = [];
  /** Pressure above rest of each taxel, in counts. */
  pressure = new Float32Array(TAXELS);
  /** The sensor's clock at the last frame, and when that arrived by our clock; null before the first. */
  frameMs = null;
  frameAt = null;
  /** The touch's pressure over time: [seconds since it began, total counts]. */
  trace = [];
  #rest = null;
  #recent = [];

  /** The ongoing touch, or else the last one; undefined before the first. */
  get touch() {
    return this.touches.at(-1);
  }

  get isTouched() {
    return this.touch !== undefined && this.touch.ended === null;
  }

  /** Seconds that the last touch has lasted. */
  get elapsed() {
    const touch = this.touch;
    if (touch === undefined) return 0;
    if (touch.ended !== null) return touch.ended.frames / this.scene.frame_rate_hz;
    return this.frameMs === null ? 0 : this.#sinceBegan(this.frameMs);
  }

  apply(message) {
    switch (message.type) {
      case "state": {
        const before = this.touch?.began;
        ({ sensor: this.sensor, robot: this.robot, touches: this.touches, action: this.action } = message);
        this.scene = message;
        this.live = null;
        this.reported = new Set(message.reported);
        this.said = new Map(Object.entries(message.said).map(([touch, gesture]) => [Number(touch), gesture]));
        const began = this.touch?.began;
        if (began?.touch !== before?.touch || began?.time !== before?.time) {
          this.trace = this.#lateTrace();
          if (this.isTouched && message.rest.length > 0) this.#rest = Float32Array.from(message.rest);
        }
        break;
      }
      case "sensor":
        this.sensor = message;
        break;
      case "robot":
        this.robot = message;
        break;
      case "robot_action":
        if (message.action !== "leds") this.action = message;
        break;
      case "status":
        this.status = message;
        break;
      case "live_prediction":
        this.live = message;
        break;
      case "touch_began":
        this.touches = [...this.touches, { began: message, predictions: [], ended: null }].slice(-TOUCHES);
        this.live = null;
        this.action = null;
        this.trace = this.#lateTrace();
        break;
      case "prediction":
        if (this.touch?.began.touch === message.touch) this.touch.predictions.push(message);
        if (message.told && this.robot?.state === "up") this.reported.add(message.touch);
        this.live = null;
        break;
      case "label":
        this.said.set(message.touch, message.gesture);
        break;
      case "touch_ended":
        if (this.touch?.began.touch === message.touch) this.touch.ended = message;
        this.live = null;
        break;
    }
  }

  /** Take a frame: the sensor's clock (uint32), the counts (uint16), little-endian, the pad. */
  takeFrame(buffer, now) {
    if (buffer.byteLength !== FRAME_BYTES) return;
    const view = new DataView(buffer);
    const counts = Float32Array.from({ length: TAXELS }, (_, taxel) => view.getUint16(4 + 2 * taxel, true));
    this.frameMs = view.getUint32(0, true);
    this.frameAt = now;
    this.#followRest(counts);
    let [load, down, over] = [0, 0, 0];
    for (let taxel = 0; taxel < TAXELS; taxel++) {
      const pressed = Math.max(0, counts[taxel] - this.#rest[taxel] - NOISE_COUNTS);
      this.pressure[taxel] = pressed;
      load += pressed;
      down += pressed * Math.floor(taxel / 8);
      over += pressed * (taxel % 8);
    }
    this.#followHand(load > LIGHTEST_LOAD ? [down / load, over / load] : [null, null]);
    this.#recent.push([this.frameMs, load]);
    if (this.#recent.length > RECENT_FRAMES) this.#recent.shift();
    if (this.isTouched) this.trace.push([this.#sinceBegan(this.frameMs), load]);
    if (this.trace.length > 60 * this.scene.frame_rate_hz) this.trace.shift();
  }

  /** Under a light hand, noise moves the centroid of pressure, so the trail follows it smoothly. */
  #followHand([row, column]) {
    const [, lastRow, lastColumn] = this.trail.at(-1) ?? [0, null, null];
    const follow = (last, now) => (now === null || last === null ? now : last + FOLLOW * (now - last));
    this.trail.push([this.frameMs, follow(lastRow, row), follow(lastColumn, column)]);
    if (this.trail.length > RECENT_FRAMES) this.trail.shift();
  }

  /** Follow each taxel's rest while nothing touches; if a touch came first, assume a low rest. */
  #followRest(counts) {
    if (this.isTouched) {
      this.#rest ??= new Float32Array(TAXELS).fill(NOISE_COUNTS);
    } else if (this.#rest === null) {
      this.#rest = counts;
    } else {
      this.#rest.forEach((rest, taxel) => {
        this.#rest[taxel] += (counts[taxel] - rest) / REST_FRAMES;
      });
    }
  }

  #lateTrace() {
    if (!this.isTouched) return [];
    return this.#recent
      .map(([frameMs, load]) => [this.#sinceBegan(frameMs), load])
      .filter(([seconds]) => seconds >= 0);
  }

  /** The sensor's clock wraps at 32 bits; the difference may be negative. */
  #sinceBegan(frameMs) {
    return ((frameMs - this.touch.began.sensor_ms) | 0) / 1000;
  }
}
