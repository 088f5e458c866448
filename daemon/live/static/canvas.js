// A canvas that keeps its memory and its size from one picture to the next, and the colours to draw in.

/** A colour of the theme. The page is loaded again when the theme changes. */
export const colourOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** A canvas at the screen's resolution. It observes its size, because asking for the size forces a layout. */
export class SharpCanvas {
  #canvas;
  /** In CSS pixels. */
  width;
  #height;

  /** The window gets a "resize" when the canvas has another size, to draw it again. */
  constructor(id) {
    const canvas = document.getElementById(id);
    this.#canvas = canvas;
    [this.width, this.#height] = [canvas.clientWidth, canvas.clientHeight];
    new ResizeObserver(() => {
      [this.width, this.#height] = [canvas.clientWidth, canvas.clientHeight];
      dispatchEvent(new Event("resize"));
    }).observe(canvas);
  }

  /** Return its cleared context. */
  clear() {
    const ratio = devicePixelRatio || 1;
    const [width, height] = [this.width, this.#height].map((length) => Math.round(length * ratio));
    const context = this.#canvas.getContext("2d");
    // Setting the size allocates new memory, even if it is the same size.
    if (this.#canvas.width !== width || this.#canvas.height !== height) {
      [this.#canvas.width, this.#canvas.height] = [width, height];
    } else {
      context.clearRect(0, 0, width, height);
    }
    return context;
  }
}
