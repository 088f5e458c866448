// The time line of a touch: its pressure, the marks at which answers fall due, and the answers at their times.

import { colourOf, SharpCanvas } from "./canvas.js";
import { make, nameOf, percent, replacedBy, saidAt, seconds, wordsOf } from "./words.js";

const SHORTEST_S = 4;
const AFTER_FINAL = 1.5;
// The total of counts that fills half of the height, unless a touch is firmer.
const LIGHT_LOAD = 300;
// An answer this long after its last frame shows both times.
const LATE_S = 0.1;
const ROWS = 4;

const canvas = new SharpCanvas("trace");
const [marks, flags] = [document.getElementById("marks"), document.getElementById("flags")];
const color = colourOf("--accent");
let drawnMarks = "";
let drawnFlags = "";

/** Draw the touch's pressure so far, the marks with those that were passed, and the answers. */
export function drawLine(store) {
  drawPressure(store);
  showMarks(store);
  showFlags(store);
}

function drawPressure(store) {
  const context = canvas.clear();
  const { width, height } = context.canvas;
  const end = endOf(store.scene);
  const points = store.trace.filter(([at]) => at >= 0 && at <= end);
  if (points.length === 0) return;
  const peak = points.reduce((most, [, load]) => Math.max(most, load), LIGHT_LOAD);
  const x = (at) => (at / end) * width;
  context.beginPath();
  context.moveTo(x(points[0][0]), height);
  for (const [at, load] of points) context.lineTo(x(at), height * (1 - 0.92 * Math.sqrt(load / peak)));
  context.lineTo(x(points.at(-1)[0]), height);
  context.fillStyle = color;
  context.globalAlpha = 0.28;
  context.fill();
  context.globalAlpha = 1;
}

function showFlags(store) {
  const { touch, pad, time } = store.touch?.began ?? {};
  const all = store.touch?.predictions ?? [];
  const { width } = canvas;
  const key = [pad, time, touch, all.length, endOf(store.scene), width].join();
  if (key === drawnFlags) return;
  drawnFlags = key;
  // The answers on the line, and the last of those after its end.
  const isShown = (one, place) => saidAt(one) < endOf(store.scene) || place === all.length - 1;
  const made = all.map((prediction, place) => flag(prediction, replacedBy(all, place), store.scene));
  flags.replaceChildren(...made.filter((_, place) => isShown(all[place], place)));
  arrange([...flags.children], width);
}

function showMarks({ scene, elapsed }) {
  const end = endOf(scene);
  const times = scene.answer_at_frames.map((frames) => frames / scene.frame_rate_hz);
  const key = times.map((at) => `${at} ${elapsed >= at}`).join() + end;
  if (key === drawnMarks) return;
  drawnMarks = key;
  marks.replaceChildren(
    ...times.map((at) => {
      const mark = make("li", elapsed >= at ? "reached" : "", make("span", "", seconds(at)));
      mark.style.setProperty("--at", at / end);
      return mark;
    }),
  );
}

function endOf(scene) {
  const final = (scene.answer_at_frames.at(-1) ?? 0) / scene.frame_rate_hz;
  return Math.max(SHORTEST_S, final * AFTER_FINAL);
}

/** before: the told answer that this one replaced, undefined without one. */
function flag(prediction, before, scene) {
  const said = saidAt(prediction);
  const at = said / endOf(scene);
  const share = prediction.gesture === "uncertain" ? "" : percent(prediction.confidence);
  const when = `saw ${seconds(prediction.elapsed_s)}, ${prediction.told ? "told" : "said"} at ${seconds(said)}`;
  // An answer after the line's end shows its times, too.
  const isLate = at > 1 || said - prediction.elapsed_s > LATE_S;
  const small = make("small", "", isLate ? make("span", "times", when) : "", prediction.told ? " ✓" : "");
  small.setAttribute("aria-hidden", "true");
  const spoken = [when, ...(before ? [`before: ${nameOf(before.gesture)}`] : [])];
  const name = make("span", "name", wordsOf(prediction));
  const item = make("li", before ? "changed" : "", name, share, small);
  item.append(...spoken.map((text) => make("span", "unseen", `, ${text}`)));
  Object.assign(item.dataset, { frames: prediction.frames, gesture: prediction.gesture });
  item.style.setProperty("--at", Math.min(at, 1));
  item.title = when;
  return item;
}

/**
 * Keep each flag within the line, to the right or else to the left of its mark: without its times if these need too
 * much room, and with its name cut if that does. Put each into the highest row in which it covers no other.
 */
function arrange(flags, width) {
  const taken = [];
  for (const item of flags) {
    const at = item.offsetLeft;
    item.classList.add("whole");
    if (item.offsetWidth > Math.max(at, width - at)) item.querySelector(".times")?.remove();
    item.classList.toggle("left", at + item.offsetWidth > width && at > width - at);
    item.classList.remove("whole");
    const { left, right } = item.getBoundingClientRect();
    const covers = (row) => taken.some((other) => other.row === row && left < other.right && right > other.left);
    const row = [...Array(ROWS).keys()].find((one) => !covers(one)) ?? ROWS - 1;
    item.style.setProperty("--row", row);
    taken.push({ row, left, right });
  }
}
