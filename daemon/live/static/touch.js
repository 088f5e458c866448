// A pad that can be touched: what mouse, fingers and pens press on its picture is sent to touchd.

// The simulated hand resumes when nobody has touched for this long.
const ALONE_MS = 20_000;
// Pointers that are held still are sent again, so that touchd knows that they still press.
const AGAIN_MS = 100;
const MOST_POINTERS = 10;

export class Touch {
  #square;
  #invitation;
  #send;
  #pointers = new Map();
  #isDue = false;
  #again = 0;
  #alone = 0;
  #isTouchable = false;
  #size;

  /** square: the pad. invitation: shown until somebody touches. size: returns "hand" or "fingertips". */
  constructor(square, invitation, size, send) {
    this.#square = square;
    this.#invitation = invitation;
    this.#size = size;
    this.#send = send;
    // The simulated hand leaves as a mouse comes near, so that it is no part of the first touch.
    square.addEventListener("pointerenter", () => this.#isTouchable && this.#soon());
    square.addEventListener("pointerdown", (event) => this.#down(event));
    square.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      square.addEventListener(end, (event) => this.#up(event));
    }
    square.addEventListener("contextmenu", (event) => this.#isTouchable && event.preventDefault());
  }

  use(isTouchable) {
    if (isTouchable === this.#isTouchable) return;
    this.#isTouchable = isTouchable;
    document.body.toggleAttribute("data-touchable", isTouchable);
    this.#invitation.hidden = !isTouchable;
  }

  #down(event) {
    if (!this.#isTouchable || event.button !== 0 || this.#pointers.size >= MOST_POINTERS) return;
    this.#square.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, event);
    this.#invitation.hidden = true;
    clearTimeout(this.#alone);
    this.#soon();
  }

  #move(event) {
    if (!this.#pointers.has(event.pointerId)) return;
    this.#pointers.set(event.pointerId, event);
    this.#soon();
  }

  #up(event) {
    // Send the press of a click that begins and ends between two pictures.
    if (this.#isDue) this.#tell();
    if (!this.#pointers.delete(event.pointerId)) return;
    clearTimeout(this.#alone);
    if (this.#pointers.size === 0) {
      this.#alone = setTimeout(() => {
        this.#invitation.hidden = false;
      }, ALONE_MS);
    }
    this.#tell();
  }

  #soon() {
    if (this.#isDue) return;
    this.#isDue = true;
    requestAnimationFrame(() => this.#isDue && this.#tell());
  }

  #tell() {
    this.#isDue = false;
    clearTimeout(this.#again);
    const { left, top, width, height } = this.#square.getBoundingClientRect();
    const at = [];
    let isFinger = this.#pointers.size > 1;
    for (const { pointerId, clientX, clientY, pressure, pointerType } of this.#pointers.values()) {
      const [x, y] = [(clientX - left) / width, (clientY - top) / height];
      isFinger ||= pointerType === "pen";
      // Beyond the edge the hand has left the pad.
      if (x < 0 || x > 1 || y < 0 || y > 1) continue;
      // A mouse, and a screen that measures no pressure, report a constant.
      const isMeasured = pointerType === "pen" || (pointerType === "touch" && ![0, 0.5, 1].includes(pressure));
      at.push([pointerId >>> 0, round(x), round(y), isMeasured ? round(Math.min(pressure, 1)) : null]);
    }
    this.#send(JSON.stringify({ size: isFinger ? "finger" : this.#size(), at }));
    if (this.#pointers.size > 0) this.#again = setTimeout(() => this.#tell(), AGAIN_MS);
  }
}

const round = (value) => Math.round(value * 1000) / 1000;
