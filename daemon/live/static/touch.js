// A pad that can be touched: what mouse, fingers and pens press on its picture is sent to touchd.

// The simulated hand resumes when nobody has touched for this long.
const ALONE_MS = 20_000;
// Pointers that are held still are sent again, so that touchd knows that they still press.
const AGAIN_MS = 100;
const MOST_POINTERS = 10;

const square = document.querySelector(".square");
const invitation = document.getElementById("invitation");
const pointers = new Map();
let isTouchable = false;
let isDue = false;
let again = 0;
let alone = 0;
let send = null;

/** Send what presses on the pad, if it can be touched; the invitation is shown until somebody touches it. */
export function useTouch(canTouch, sendMessage) {
  if (canTouch === isTouchable) return;
  isTouchable = canTouch;
  send = sendMessage;
  document.body.toggleAttribute("data-touchable", isTouchable);
  invitation.hidden = !isTouchable;
}

// The simulated hand leaves as a mouse comes near, so that it is no part of the first touch.
square.addEventListener("pointerenter", () => isTouchable && soon());
square.addEventListener("contextmenu", (event) => isTouchable && event.preventDefault());
square.addEventListener("pointerdown", (event) => {
  if (!isTouchable || event.button !== 0 || pointers.size >= MOST_POINTERS) return;
  square.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, event);
  invitation.hidden = true;
  clearTimeout(alone);
  soon();
});
square.addEventListener("pointermove", (event) => {
  if (!pointers.has(event.pointerId)) return;
  pointers.set(event.pointerId, event);
  soon();
});
for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
  square.addEventListener(end, (event) => {
    // Send the press of a click that begins and ends between two pictures.
    if (isDue) tell();
    if (!pointers.delete(event.pointerId)) return;
    clearTimeout(alone);
    if (pointers.size === 0) alone = setTimeout(() => (invitation.hidden = false), ALONE_MS);
    tell();
  });
}

function soon() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => isDue && tell());
}

function tell() {
  isDue = false;
  clearTimeout(again);
  const { left, top, width, height } = square.getBoundingClientRect();
  const at = [];
  let isFinger = pointers.size > 1;
  for (const { pointerId, clientX, clientY, pressure, pointerType } of pointers.values()) {
    const [x, y] = [(clientX - left) / width, (clientY - top) / height];
    isFinger ||= pointerType === "pen";
    // Beyond the edge the hand has left the pad.
    if (x < 0 || x > 1 || y < 0 || y > 1) continue;
    // A mouse, and a screen that measures no pressure, report a constant.
    const isMeasured = pointerType === "pen" || (pointerType === "touch" && ![0, 0.5, 1].includes(pressure));
    at.push([pointerId >>> 0, round(x), round(y), isMeasured ? round(Math.min(pressure, 1)) : null]);
  }
  const size = isFinger ? "finger" : document.querySelector("[name=size]:checked").value;
  send(JSON.stringify({ size, at }));
  if (pointers.size > 0) again = setTimeout(tell, AGAIN_MS);
}

const round = (value) => Math.round(value * 1000) / 1000;
