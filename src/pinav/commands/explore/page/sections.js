// The page of a run of bioheat on a plane or in a box: its own temperatures over time.

import { HEATING, INK, MEANING } from "./colours.js";
import { arrayOf, shown } from "./numbers.js";
import { button, choice, group, make, showLegend, slider } from "./panel.js";
import { savePicture, saveText, writeAddress } from "./sharing.js";
import { Frame, drawScale, imageOf, plot } from "./view.js";

const NONE = 65535; // the level that stands for no number
const element = (id) => document.getElementById(id);

/** Numbers between two limits from their levels. */
function numbersOf(packed, [low, high]) {
  return arrayOf(packed).map((level) => (level === NONE ? NaN : low + (level / (NONE - 1)) * (high - low)));
}

/** One plane of the tissue: temperature over time, the dose at the end, the target. */
class Section {
  constructor(packed, limits) {
    Object.assign(this, { normal: packed.normal, axes: packed.axes, at: packed.at });
    this.box = [0, 1e3 * packed.sides[0], 0, 1e3 * packed.sides[1]]; // mm
    [this.columns, this.rows] = packed.target.shape;
    this.temperature = numbersOf(packed.temperature, limits);
    this.dose = numbersOf(packed.dose.levels, packed.dose.limits);
    this.doseLimits = packed.dose.limits;
    this.target = arrayOf(packed.target);
  }

  /** The cell at a place [mm]. */
  cell([x, y]) {
    const index = (value, length, count) => Math.min(Math.max(Math.floor((value / length) * count), 0), count - 1);
    return index(x, this.box[1], this.columns) * this.rows + index(y, this.box[3], this.rows);
  }

  /** The temperature of a cell between two moments. */
  temperatureAt(cell, { index, share }) {
    const size = this.columns * this.rows;
    const below = this.temperature[index * size + cell];
    return below + share * (this.temperature[(index + 1) * size + cell] - below);
  }

  /** A quantity of all cells as an image takes them, rows from below. */
  image(of) {
    const { columns, rows } = this;
    const values = new Float64Array(columns * rows);
    for (let i = 0; i < columns; i++) for (let j = 0; j < rows; j++) values[j * columns + i] = of(i * rows + j);
    return { values, columns, rows };
  }

  /** Sides of cells at which the target begins or ends, as pairs of places [mm]. */
  *outline() {
    const { columns, rows, target } = this;
    const [w, h] = [this.box[1] / columns, this.box[3] / rows];
    const inside = (i, j) => i >= 0 && j >= 0 && i < columns && j < rows && target[i * rows + j] >= 0.5;
    for (let i = 0; i <= columns; i++) {
      for (let j = 0; j <= rows; j++) {
        if (inside(i - 1, j) !== inside(i, j)) yield [[i * w, j * h], [i * w, (j + 1) * h]];
        if (inside(i, j - 1) !== inside(i, j)) yield [[i * w, j * h], [(i + 1) * w, j * h]];
      }
    }
  }
}

export class SectionExplorer {
  constructor(run) {
    this.run = run;
    this.sections = run.sections.map((packed) => new Section(packed, run.limits));
    this.moments = arrayOf(run.moments);
    this.times = arrayOf(run.times);
    this.curves = Object.fromEntries(Object.entries(run.curves).map(([name, packed]) => [name, arrayOf(packed)]));
    this.probes = run.probes.map(arrayOf);
    this.first = this.startingConditions();
    this.conditions = this.fromAddress();
    element("subtitle").textContent =
      `Temperature of the run over time, ${this.moments.length} moments. Drag on the map to read a place, or the slider of the time. ` +
      "Synthetic data of a research code; nothing here is medical advice.";
    element("cut").hidden = false;
    this.buildPanel();
    this.listenToMap();
    new ResizeObserver(() => this.draw()).observe(element("map"));
    globalThis.addEventListener("hashchange", () => {
      this.conditions = this.fromAddress();
      this.refresh();
    });
    this.refresh();
  }

  /** The end of heating, and the middle of the target in the first plane. */
  startingConditions() {
    const { edges, starts, ends } = this.run;
    const last = starts.findLastIndex((start, k) => Math.max(start, ends[k]) > 0);
    const [{ box }] = this.sections;
    return { plane: 0, quantity: "temperature", time: edges[last < 0 ? edges.length - 1 : last + 1], x: box[1] / 2, y: box[3] / 2 };
  }

  fromAddress() {
    const given = new URLSearchParams(globalThis.location.hash.slice(1));
    const conditions = { ...this.first };
    for (const name of ["plane", "time", "x", "y"]) {
      const value = Number(given.get(name) ?? NaN);
      if (Number.isFinite(value)) conditions[name] = value;
    }
    if (!this.sections[conditions.plane]) conditions.plane = 0;
    if (given.get("quantity") === "dose") conditions.quantity = "dose";
    return this.bounded(conditions);
  }

  bounded(conditions) {
    const { box } = this.sections[conditions.plane];
    const within = (value, low, high) => Math.min(Math.max(value, low), high);
    conditions.time = within(conditions.time, this.moments[0], this.moments.at(-1));
    conditions.x = within(conditions.x, 0, box[1]);
    conditions.y = within(conditions.y, 0, box[3]);
    return conditions;
  }

  change(part) {
    this.bounded(Object.assign(this.conditions, part));
    this.refresh();
  }

  refresh() {
    this.request ??= requestAnimationFrame(() => {
      this.request = null;
      const begin = performance.now();
      this.draw();
      this.elapsed = performance.now() - begin;
      this.showConditions();
      const { plane, quantity, time, x, y } = this.conditions;
      const digits = [time, x, y].map((value) => Number(value.toPrecision(5)));
      writeAddress(`plane=${plane}&quantity=${quantity}&time=${digits[0]}&x=${digits[1]}&y=${digits[2]}`);
    });
  }

  get section() {
    return this.sections[this.conditions.plane];
  }

  /** The moments around a time: the index of the earlier, and the share of the way. */
  between(time) {
    const { moments } = this;
    const after = moments.findIndex((moment) => moment >= time);
    const index = Math.min(Math.max((after < 0 ? moments.length : after) - 1, 0), moments.length - 2);
    return { index, share: (time - moments[index]) / (moments[index + 1] - moments[index]) };
  }

  /** Temperature at the place of the cursor and the time of the slider [°C]. */
  reading() {
    const { x, y, time } = this.conditions;
    return this.section.temperatureAt(this.section.cell([x, y]), this.between(time));
  }

  draw() {
    this.drawGround();
    this.drawMarks();
    this.drawPlots();
    this.showReadout();
  }

  drawGround() {
    const { section, run } = this;
    const dose = this.conditions.quantity === "dose";
    const at = this.between(this.conditions.time);
    const image = section.image(dose ? (cell) => section.dose[cell] : (cell) => section.temperatureAt(cell, at));
    const limits = dose ? section.doseLimits : run.limits;
    const frame = new Frame(element("ground"), section.box);
    frame.clear();
    const [, width, , height] = section.box;
    frame.clip((c) => {
      c.imageSmoothingEnabled = false;
      c.drawImage(imageOf(image, limits, false), frame.px(0), frame.py(height), width * frame.sx, height * frame.sy);
    });
    frame.axes(`${section.axes[0]} [mm]`, `${section.axes[1]} [mm]`, INK);
    element("scale").hidden = false;
    drawScale(element("bar"), false);
    const text = (value) => (dose ? shown(10 ** value) : shown(value));
    element("low").textContent = text(limits[0]);
    element("high").textContent = text(limits[1]);
    element("unit").textContent = dose ? "dose at the end [CEM43 min], logarithmic" : "temperature [°C]";
  }

  /** Outline of the target, probes near the plane, and the cursor. */
  drawMarks() {
    const { section } = this;
    const frame = (this.mapFrame = new Frame(element("paths"), section.box));
    frame.clear();
    for (const side of section.outline()) frame.curve(side, MEANING.target, { width: 1.6 });
    for (const point of this.run.points) frame.dot(section.axes.map((axis) => 1e3 * point["xyz".indexOf(axis)]), HEATING.probe, 5);
    frame.dot([this.conditions.x, this.conditions.y], HEATING.here, 8, false);
  }

  drawPlots() {
    const over = (values) => Array.from(this.times, (t, i) => [t, values[i]]);
    const cell = this.section.cell([this.conditions.x, this.conditions.y]);
    const size = this.section.columns * this.section.rows;
    const here = Array.from(this.moments, (t, i) => [t, this.section.temperature[i * size + cell]]);
    const temperatures = [
      ...this.probes.map((values) => ({ points: over(values), colour: HEATING.probe, width: 1 })),
      { points: over(this.curves.T90), colour: HEATING.T90 },
      { points: over(this.curves.hottest), colour: HEATING.hottest },
      { points: here, colour: HEATING.here },
    ];
    const now = this.conditions.time;
    plot(element("plot-x"), temperatures, ["t [s]", "T [°C]"], INK, now);
    const doses = [
      { points: over(this.curves["dose/outside"]), colour: HEATING.outside, dash: [2, 4] },
      { points: over(this.curves["dose/D90"]), colour: HEATING.T90 },
    ];
    plot(element("plot-y"), doses, ["t [s]", "CEM43 [min]"], INK, now);
    const { edges, starts, ends } = this.run;
    const field = starts.flatMap((start, k) => [[edges[k], start / 1e3], [edges[k + 1], ends[k] / 1e3]]);
    plot(element("plot-cut"), [{ points: field, colour: HEATING.field }], ["t [s]", "field [kA/m]"], INK, now);
  }

  showReadout() {
    const { x, y, time } = this.conditions;
    const { section } = this;
    const dose = 10 ** section.dose[section.cell([x, y])];
    element("readout").textContent =
      `At ${section.axes[0]} = ${shown(x)} mm, ${section.axes[1]} = ${shown(y)} mm and ${shown(time, 4)} s: ` +
      `${shown(this.reading(), 4)} °C; ${shown(dose)} CEM43 min at the end. ` +
      `90 % of the target get at least ${shown(this.curves["dose/D90"].at(-1))} CEM43 min.`;
    const entries = [["here", HEATING.here], ["hottest cell", HEATING.hottest], ["T90 and D90 of the target", HEATING.T90]];
    if (this.probes.length) entries.push(["probes", HEATING.probe]);
    entries.push(["largest dose outside", HEATING.outside], ["target", MEANING.target], ["field", HEATING.field]);
    showLegend(entries);
  }

  listenToMap() {
    const canvas = element("paths");
    canvas.setAttribute("aria-label", "Map of temperature. Arrow keys move the place, with Shift left and right the time.");
    const read = (event) => {
      if (!event.buttons) return;
      const bounds = canvas.getBoundingClientRect();
      const [x, y] = this.mapFrame.place(event.clientX - bounds.left, event.clientY - bounds.top);
      this.change({ x, y });
    };
    canvas.addEventListener("pointerdown", read);
    canvas.addEventListener("pointermove", read);
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
      if (!step) return;
      event.preventDefault();
      const { time, x, y } = this.conditions;
      const { box, columns, rows } = this.section;
      if (event.shiftKey) this.change({ time: time + (step[0] * this.moments.at(-1)) / 100 });
      else this.change({ x: x + (step[0] * box[1]) / columns, y: y + (step[1] * box[3]) / rows });
    });
  }

  buildPanel() {
    const last = this.moments.at(-1);
    this.clock = slider("time [s]", { low: this.moments[0], high: last, step: "any" }, (time) => this.change({ time }));
    const quantities = [["temperature", "temperature"], ["dose", "dose at the end"]];
    this.quantity = choice("shows", quantities, (quantity) => this.change({ quantity }));
    const planes = this.sections.map(({ normal, at }, k) => [k, at === null ? "the plane" : `${normal} = ${shown(1e3 * at)} mm`]);
    this.plane = choice("plane", planes, (plane) => this.change({ plane: Number(plane) }));
    const name = this.run.run.replace(/[^\w-]+/g, "-");
    const picture = button("Picture", () => savePicture(`${name}.png`, [element("ground"), element("paths")]));
    const table = button("Curves as CSV", () => saveText(`${name}-curves.csv`, this.table()));
    const again = button("As at first", () => this.change({ ...this.first }));
    element("panel").append(
      group("Time", this.clock),
      group("Map", this.quantity, ...(planes.length > 1 ? [this.plane] : [])),
      group("Take away", make("div", { class: "buttons" }, picture, table, again)),
    );
  }

  table() {
    const { curves, probes, times } = this;
    const names = ["hottest", "T90", "T50", "T10"];
    const header = ["t [s]", ...names.map((name) => `${name} [°C]`), "D90 [min]", ...probes.map((_, i) => `probe ${i + 1} [°C]`)];
    const columns = [times, ...names.map((name) => curves[name]), curves["dose/D90"], ...probes];
    const rows = Array.from(times, (_, i) => columns.map((column) => column[i]).join(","));
    return [header.join(","), ...rows, ""].join("\n");
  }

  showConditions() {
    this.clock.set(this.conditions.time);
    this.quantity.set(this.conditions.quantity);
    this.plane.set(this.conditions.plane);
  }
}
