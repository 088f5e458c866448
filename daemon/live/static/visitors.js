// The view for visitors: the whole screen, nothing but pad, answer, time line and the robot's words.

import { seconds } from "./words.js";

const HASH = "#visitors";
const button = document.getElementById("enter");
const { body } = document;

/** Switch the view by its button, by the key v, or by the address. onChange: called when it has switched. */
export function followVisitors(onChange) {
  function show(isShown) {
    body.toggleAttribute("data-visitors", isShown);
    button.setAttribute("aria-pressed", isShown);
    button.setAttribute("aria-label", isShown ? "Leave the visitors' view" : "Visitors");
    button.textContent = isShown ? "✕" : "Visitors";
    history.replaceState(null, "", isShown ? HASH : location.pathname);
    onChange();
  }

  function toggle() {
    const isShown = !body.hasAttribute("data-visitors");
    show(isShown);
    // The browser may refuse full screen; the view works without it.
    if (isShown) document.documentElement.requestFullscreen?.().catch(() => {});
    else if (document.fullscreenElement) document.exitFullscreen();
  }

  button.addEventListener("click", toggle);
  document.addEventListener("keydown", ({ key, ctrlKey, metaKey, altKey }) => {
    if (key === "v" && !ctrlKey && !metaKey && !altKey) toggle();
  });
  document.addEventListener("fullscreenchange", () => {
    if (!document.fullscreenElement) show(false);
  });
  addEventListener("hashchange", () => show(location.hash === HASH));
  show(location.hash === HASH);
}

/** Fill the legend with the scene's marks. */
export function showLegend(scene) {
  const marks = scene.answer_at_frames.map((frames) => seconds(frames / scene.frame_rate_hz));
  const list = new Intl.ListFormat("en", { style: "long" }).format(marks);
  document.getElementById("legend").textContent =
    `The stronger the colour, the firmer the touch. touchd names what your hand does after ${list}. ↻ marks a change of mind, ✓ what the robot was told.`;
}
