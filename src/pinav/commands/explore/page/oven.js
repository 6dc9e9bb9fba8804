// The page of a run of bioheat: drag the protocol, see temperature and dose.

import { HEATING, INK } from "./colours.js";
import { arrayOf, shown } from "./numbers.js";
import { button, group, make, showLegend, slider } from "./panel.js";
import { saveText, writeAddress } from "./sharing.js";
import { Tissue } from "./tissue.js";
import { Frame, drawScale, imageOf, plot } from "./view.js";

const part = (id) => document.getElementById(id);

export class HeatExplorer {
  constructor(run) {
    this.run = run;
    this.tissue = new Tissue(run.balance);
    this.radius = arrayOf(run.radius);
    this.target = arrayOf(run.target);
    this.saved = { times: arrayOf(run.times), hottest: arrayOf(run.hottest), dose: arrayOf(run.dose) };
    this.most = this.tissue.amplitudes.at(-1);
    this.first = { edges: run.edges, starts: run.starts, ends: run.ends, time: run.edges.at(-1) / 2 };
    this.conditions = this.fromAddress();
    part("subtitle").textContent =
      "Temperature over radius and time. Drag the amplitudes of the field, or the time on the map. " +
      "Synthetic data of a research code; nothing here is medical advice.";
    part("cut").hidden = false;
    this.buildPanel();
    this.listenToMap();
    new ResizeObserver(() => this.draw()).observe(part("map"));
    globalThis.addEventListener("hashchange", () => {
      this.conditions = this.fromAddress();
      this.refresh();
    });
    this.refresh();
  }

  fromAddress() {
    const given = new URLSearchParams(globalThis.location.hash.slice(1));
    const count = this.first.starts.length;
    const list = (name) => {
      const values = (given.get(name) ?? "").split(",").map(Number);
      const fits = given.get(name) && values.length === count && values.every((a) => a >= 0 && a <= this.most);
      return fits ? values : [...this.first[name]];
    };
    const time = Number(given.get("time") ?? this.first.time);
    return {
      edges: this.first.edges,
      starts: list("starts"),
      ends: list("ends"),
      time: Number.isFinite(time) ? time : this.first.time,
    };
  }

  writeAddress() {
    const { starts, ends, time } = this.conditions;
    const digits = (values) => values.map((value) => Number(value.toPrecision(5))).join(",");
    writeAddress(`starts=${digits(starts)}&ends=${digits(ends)}&time=${digits([time])}`);
  }

  /** Run again at the next frame. */
  refresh() {
    this.request ??= requestAnimationFrame(() => {
      this.request = null;
      const begin = performance.now();
      this.result = this.tissue.run(this.conditions);
      this.elapsed = performance.now() - begin;
      this.draw();
      this.showConditions();
      this.writeAddress();
    });
  }

  series(name) {
    const { times, fields, doses } = this.result;
    const of = {
      hottest: (i) => fields[i].reduce((a, b) => Math.max(a, b)),
      T90: (i) => this.tissue.exceeded(fields[i], this.target, 0.9),
      T10: (i) => this.tissue.exceeded(fields[i], this.target, 0.1),
      D90: (i) => this.tissue.exceeded(doses[i], this.target, 0.9),
    }[name];
    return times.map((t, i) => [t, of(i)]);
  }

  /** Index of the last saved moment before the time of the cursor. */
  get moment() {
    const { times } = this.result;
    const after = times.findIndex((t) => t > this.conditions.time);
    return after < 0 ? times.length - 1 : Math.max(after - 1, 0);
  }

  draw() {
    if (!this.result) return;
    this.drawMap();
    const saved = (values) => Array.from(this.saved.times, (t, i) => [t, values[i]]);
    const probe = (r) => {
      const near = this.radius.reduce((best, place, i) => (Math.abs(place - r) < Math.abs(this.radius[best] - r) ? i : best), 0);
      return this.result.times.map((t, i) => [t, this.result.fields[i][near]]);
    };
    const temperatures = [
      { points: saved(this.saved.hottest), colour: HEATING.asRun, dash: [2, 4] },
      ...this.run.probes.map((r) => ({ points: probe(r), colour: HEATING.probe, width: 1 })),
      { points: this.series("T90"), colour: HEATING.T90 },
      { points: this.series("hottest"), colour: HEATING.hottest },
    ];
    plot(part("plot-x"), temperatures, ["t [s]", "T [°C]"], INK);
    const doses = [
      { points: saved(this.saved.dose), colour: HEATING.asRun, dash: [2, 4] },
      { points: this.series("D90"), colour: HEATING.D90 },
    ];
    plot(part("plot-y"), doses, ["t [s]", "D90 [CEM43 min]"], INK);
    const field = this.result.fields[this.moment];
    const profile = [{ points: Array.from(this.radius, (r, i) => [1e3 * r, field[i]]), colour: HEATING.here }];
    plot(part("plot-cut"), profile, ["radius [mm]", "T [°C]"], INK);
    this.showReadout();
  }

  /** Temperature over time (right) and radius (up), as an image. */
  drawMap() {
    const { times, fields } = this.result;
    const [last, outer] = [times.at(-1), 1e3 * this.radius.at(-1)];
    const count = 120;
    const values = new Float64Array(count * count);
    let moment = 0;
    for (let i = 0; i < count; i++) {
      while (moment < times.length - 1 && times[moment] < (i / (count - 1)) * last) moment++;
      for (let j = 0; j < count; j++) {
        const cell = Math.min(Math.floor((j / count) * this.radius.length), this.radius.length - 1);
        values[j * count + i] = fields[moment][cell];
      }
    }
    const limits = [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
    const frame = new Frame(part("ground"), [0, last, 0, outer], false);
    frame.clear();
    const image = imageOf({ values, count }, limits, false);
    frame.clip((c) => c.drawImage(image, frame.px(0), frame.py(outer), last * frame.sx, outer * frame.sy));
    frame.axes("t [s]", "radius [mm]", INK);
    part("scale").hidden = false;
    drawScale(part("bar"), false);
    part("low").textContent = shown(limits[0]);
    part("high").textContent = shown(limits[1]);
    part("unit").textContent = "temperature [°C]";
    const over = (this.mapFrame = new Frame(part("paths"), [0, last, 0, outer], false));
    over.clear();
    const time = Math.min(this.conditions.time, last);
    over.curve([[time, 0], [time, outer]], HEATING.here, { casing: true });
  }

  showReadout() {
    const field = this.result.fields[this.moment];
    const dose = this.series("D90").at(-1)[1];
    const hottest = this.series("hottest").reduce((a, [, t]) => Math.max(a, t), -Infinity);
    const now = field.reduce((a, b) => Math.max(a, b));
    part("readout").textContent =
      `Hottest ${shown(hottest, 4)} °C, at the cursor ${shown(now, 4)} °C. ` +
      `90 % of the target get at least ${shown(dose)} CEM43 min.`;
    const entries = [["hottest cell", HEATING.hottest], ["T90 and D90 of the target", HEATING.T90], ["at the cursor", HEATING.here]];
    if (this.run.probes.length) entries.push(["probes", HEATING.probe]);
    entries.push(["as it was run", HEATING.asRun]);
    showLegend(entries);
  }

  listenToMap() {
    const canvas = part("paths");
    const last = this.first.edges.at(-1);
    canvas.setAttribute("aria-label", "Map of temperature. Arrow keys move the time.");
    const move = (time) => {
      this.conditions.time = Math.min(Math.max(time, 0), last);
      this.draw();
      this.showConditions();
      this.writeAddress();
    };
    const drag = (event) => {
      if (!event.buttons) return;
      const bounds = canvas.getBoundingClientRect();
      move(this.mapFrame.place(event.clientX - bounds.left, 0)[0]);
    };
    canvas.addEventListener("pointerdown", drag);
    canvas.addEventListener("pointermove", drag);
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (step) move(this.conditions.time + (step * last) / 100);
    });
  }

  buildPanel() {
    const { edges, starts, ends } = this.first;
    const range = { low: 0, high: this.most / 1e3, step: "any" };
    this.rows = [];
    starts.forEach((_, k) => {
      const name = `${shown(edges[k])} to ${shown(edges[k + 1])} s`;
      const flat = starts[k] === ends[k];
      const set = (keys) => (value) => {
        for (const key of keys) this.conditions[key][k] = Math.min(Math.max(1e3 * value, 0), this.most);
        this.refresh();
      };
      if (flat) this.rows.push([slider(`${name} [kA/m]`, range, set(["starts", "ends"])), "starts", k]);
      else {
        this.rows.push([slider(`${name}, at first [kA/m]`, range, set(["starts"])), "starts", k]);
        this.rows.push([slider(`${name}, at last [kA/m]`, range, set(["ends"])), "ends", k]);
      }
    });
    const time = { low: 0, high: edges.at(-1), step: "any" };
    this.clock = slider("time of the profile [s]", time, (value) => {
      this.conditions.time = value;
      this.refresh();
    });
    const again = button("As at first", () => {
      Object.assign(this.conditions, structuredClone(this.first));
      this.refresh();
    });
    const name = this.run.run.replace(/[^\w-]+/g, "-");
    const table = button("Curves as CSV", () => saveText(`${name}-curves.csv`, this.table()));
    part("panel").append(
      group("Amplitude of the field", ...this.rows.map(([row]) => row)),
      group("Time", this.clock),
      group("Take away", make("div", { class: "buttons" }, table, again)),
    );
  }

  table() {
    const [hottest, t90, t10, dose] = ["hottest", "T90", "T10", "D90"].map((name) => this.series(name));
    const rows = hottest.map(([t, value], i) => [t, value, t90[i][1], t10[i][1], dose[i][1]].join(","));
    return ["t [s],hottest [°C],T90 [°C],T10 [°C],D90 [min]", ...rows, ""].join("\n");
  }

  showConditions() {
    for (const [row, key, k] of this.rows) row.set(this.conditions[key][k] / 1e3);
    this.clock.set(this.conditions.time);
  }
}
