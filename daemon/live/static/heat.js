// The pad as a heat map: pressure between the taxels is interpolated, then coloured.

import { colourOf, SharpCanvas } from "./canvas.js";
import { make } from "./words.js";

const SIDE = 8;
const PIXELS = 128;
const SHADES = 256;
const STOPS = 6;
// Colours rise with the logarithm of pressure, so that a stroke is visible beside a slap. The scale is almost linear
// below the first of these counts and ends at the second.
const LIGHT_COUNTS = 4;
const FIRM_COUNTS = 250;
// With reduced motion, pressure is averaged over about a third of a second.
const CALM_SHARE = 1 / 18;

/** For each of 128 pixels, the weights of the eight taxels in its row or column, by the Catmull-Rom cubic. */
const WEIGHTS = Array.from({ length: PIXELS }, (_, pixel) => {
  const at = ((pixel + 0.5) * SIDE) / PIXELS - 0.5;
  const t = at - Math.floor(at);
  const cubic = [
    ((2 - t) * t - 1) * t,
    (3 * t - 5) * t * t + 2,
    ((4 - 3 * t) * t + 1) * t,
    (t - 1) * t * t,
  ];
  const weights = new Float32Array(SIDE);
  cubic.forEach((weight, i) => {
    weights[Math.min(Math.max(Math.floor(at) - 1 + i, 0), SIDE - 1)] += weight / 2;
  });
  return weights;
});

/** Return the theme's colours of pressure, one packed pixel a shade. */
function shades() {
  const stops = Array.from({ length: STOPS }, (_, i) => {
    const hex = Number.parseInt(colourOf(`--heat-${i}`).slice(1), 16);
    return [hex >> 16, (hex >> 8) & 255, hex & 255];
  });
  return Uint32Array.from({ length: SHADES }, (_, shade) => {
    const at = (shade / (SHADES - 1)) * (STOPS - 1);
    const stop = Math.min(Math.floor(at), STOPS - 2);
    const [red, green, blue] = stops[stop].map((from, i) =>
      Math.round(from + (stops[stop + 1][i] - from) * (at - stop)),
    );
    return (255 << 24) | (blue << 16) | (green << 8) | red;
  });
}

/** The marks of the scale, in counts. */
const MARKS = [0, 20, FIRM_COUNTS];

/** Return a count's place on the scale of colours, from 0 to 1. */
const levelOf = (counts) => Math.log1p(counts / LIGHT_COUNTS) / Math.log1p(FIRM_COUNTS / LIGHT_COUNTS);

/** Write the counts beside the scale of colours. */
export function showScale() {
  document.getElementById("counts").replaceChildren(
    ...MARKS.map((counts) => {
      const mark = make("li", "", counts === 0 ? "0 counts" : counts);
      mark.style.setProperty("--at", levelOf(counts));
      return mark;
    }),
  );
}

const trailCanvas = new SharpCanvas("trail");
const trailColor = colourOf("--trail");

/** Draw where the hand was in the last second, fading with time. */
export function drawTrail(trail) {
  const context = trailCanvas.clear();
  const side = context.canvas.width;
  const at = (taxels) => ((taxels + 0.5) / SIDE) * side;
  context.strokeStyle = trailColor;
  context.lineCap = "round";
  context.lineWidth = side / 90;
  for (let i = 1; i < trail.length; i++) {
    const [[, row, column], [, nextRow, nextColumn]] = [trail[i - 1], trail[i]];
    if (row === null || nextRow === null) continue;
    context.globalAlpha = (i / trail.length) ** 2;
    context.beginPath();
    context.moveTo(at(column), at(row));
    context.lineTo(at(nextColumn), at(nextRow));
    context.stroke();
  }
}

export class HeatMap {
  #context;
  #image = new ImageData(PIXELS, PIXELS);
  #pixels = new Uint32Array(this.#image.data.buffer);
  #shades = shades();
  #levels = new Float32Array(SIDE * SIDE);
  #rows = new Float32Array(SIDE * PIXELS);
  #calm = matchMedia("(prefers-reduced-motion: reduce)");

  /** scale: a canvas for the colours from light to firm, null for none. */
  constructor(canvas, scale) {
    this.#context = canvas.getContext("2d");
    if (!scale) return;
    const image = new ImageData(SHADES, 1);
    new Uint32Array(image.data.buffer).set(this.#shades);
    scale.getContext("2d").putImageData(image, 0, 0);
  }

  /** Draw pressure above rest, 64 counts. */
  draw(pressure) {
    const share = this.#calm.matches ? CALM_SHARE : 1;
    for (let taxel = 0; taxel < SIDE * SIDE; taxel++) {
      const level = levelOf(pressure[taxel]);
      this.#levels[taxel] += (level - this.#levels[taxel]) * share;
    }
    this.#stretch();
    this.#context.putImageData(this.#image, 0, 0);
  }

  #stretch() {
    const [levels, rows, pixels, shades] = [this.#levels, this.#rows, this.#pixels, this.#shades];
    for (let row = 0; row < SIDE; row++) {
      for (let x = 0; x < PIXELS; x++) {
        let level = 0;
        for (let taxel = 0; taxel < SIDE; taxel++) level += WEIGHTS[x][taxel] * levels[row * SIDE + taxel];
        rows[row * PIXELS + x] = level;
      }
    }
    for (let y = 0; y < PIXELS; y++) {
      const weights = WEIGHTS[y];
      for (let x = 0; x < PIXELS; x++) {
        let level = 0;
        for (let row = 0; row < SIDE; row++) level += weights[row] * rows[row * PIXELS + x];
        // The cubic overshoots a little beside a steep edge.
        const shade = level < 0 ? 0 : level > 1 ? 1 : level;
        pixels[y * PIXELS + x] = shades[(shade * (SHADES - 1) + 0.5) | 0];
      }
    }
  }
}

/** Say in words where the pad is pressed most. */
export function describePressure(pressure) {
  const most = pressure.reduce((best, counts, taxel) => (counts > pressure[best] ? taxel : best), 0);
  if (pressure[most] === 0) return "Nothing presses on the pad.";
  const [row, column] = [Math.floor(most / SIDE) + 1, (most % SIDE) + 1];
  return `Firmest in row ${row}, column ${column}: ${Math.round(pressure[most])} counts.`;
}
