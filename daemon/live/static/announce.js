// Announcements for screen readers: new answers and troubles, one at a time.

const PAUSE_MS = 2000;

export class Announcer {
  #element;
  #next = new Map();
  #timer = 0;

  constructor(element) {
    this.#element = element;
  }

  /** Announce a text once the last one has had its time; of several pending texts of a kind, only the newest. */
  say(kind, text) {
    this.#next.set(kind, text);
    if (this.#timer === 0) this.#speak();
  }

  #speak() {
    this.#timer = 0;
    if (this.#next.size === 0) return;
    const [kind, text] = this.#next.entries().next().value;
    this.#next.delete(kind);
    this.#element.textContent = text;
    this.#timer = setTimeout(() => this.#speak(), PAUSE_MS);
  }
}
