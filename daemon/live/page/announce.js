// What a screen reader says of its own accord: answers that are new and troubles, one at a time.

const PAUSE_MS = 2000;

export class Announcer {
  #element;
  #next = "";
  #timer = 0;

  constructor(element) {
    this.#element = element;
  }

  /** Say a text when the last one has had its time; of several meanwhile only the newest. */
  say(text) {
    this.#next = text;
    if (this.#timer === 0) this.#speak();
  }

  #speak() {
    this.#timer = 0;
    if (this.#next === "") return;
    this.#element.textContent = this.#next;
    this.#next = "";
    this.#timer = setTimeout(() => this.#speak(), PAUSE_MS);
  }
}
