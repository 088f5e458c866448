// The view for visitors: the whole screen, nothing but pad, answer, time line and the robot's words.

import { seconds } from "./words.js";

const HASH = "#visitors";

export class Visitors {
  #button;
  #legend;
  #onChange;

  constructor(button, legend, onChange) {
    this.#button = button;
    this.#legend = legend;
    this.#onChange = onChange;
    button.addEventListener("click", () => this.#toggle());
    document.addEventListener("keydown", ({ key, ctrlKey, metaKey, altKey }) => {
      if (key === "v" && !ctrlKey && !metaKey && !altKey) this.#toggle();
    });
    document.addEventListener("fullscreenchange", () => {
      if (!document.fullscreenElement) this.#show(false);
    });
    addEventListener("hashchange", () => this.#show(location.hash === HASH));
    this.#show(location.hash === HASH);
  }

  /** Fill the legend with the scene's marks. */
  use(scene) {
    const marks = scene.answer_at_frames.map((frames) => seconds(frames / scene.frame_rate_hz));
    const list = new Intl.ListFormat("en", { style: "long" }).format(marks);
    this.#legend.textContent =
      `The stronger the colour, the firmer the touch. touchd names what your hand does after ${list}. ↻ marks a change of mind, ✓ what the robot was told.`;
  }

  get #isShown() {
    return document.body.hasAttribute("data-visitors");
  }

  #toggle() {
    const isShown = !this.#isShown;
    this.#show(isShown);
    // A page may be refused full screen; the view works without it.
    if (isShown) document.documentElement.requestFullscreen?.().catch(() => {});
    else if (document.fullscreenElement) document.exitFullscreen();
  }

  #show(isShown) {
    document.body.toggleAttribute("data-visitors", isShown);
    this.#button.setAttribute("aria-pressed", isShown);
    this.#button.textContent = isShown ? "✕" : "Visitors";
    this.#button.setAttribute("aria-label", isShown ? "Leave the visitors' view" : "Visitors");
    history.replaceState(null, "", isShown ? HASH : location.pathname);
    this.#onChange();
  }
}
