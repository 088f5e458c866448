// Announcements for screen readers: new answers and troubles, one at a time.

const PAUSE_MS = 2000;
const next = new Map();
let timer = 0;

/** Announce a text once the last one has had its time; of several pending texts of a kind, only the newest. */
export function announce(kind, text) {
  next.set(kind, text);
  if (timer === 0) speak();
}

function speak() {
  timer = 0;
  if (next.size === 0) return;
  const [kind, text] = next.entries().next().value;
  next.delete(kind);
  document.getElementById("announcement").textContent = text;
  timer = setTimeout(speak, PAUSE_MS);
}
