// The page: conditions in, pictures out.

import { INK, MEANING, PAPER, through } from "./colours.js";
import { Experiment, NORMAL_95 } from "./experiment.js";
import { listen } from "./gestures.js";
import { arrayOf, shown } from "./numbers.js";
import { HeatExplorer } from "./oven.js";
import { button, checks, choice, group, make, numberField, showLegend, slider } from "./panel.js";
import { forceAt, forceSd, grid, quantitiesOf } from "./quantities.js";
import { LAYERS, decoded, encoded, firstConditions } from "./session.js";
import { pathTable, savePicture, saveText, writeAddress } from "./sharing.js";
import { SectionExplorer } from "./sections.js";
import { Frame, drawScale, imageOf, limitsOf, plot } from "./view.js";

const FRAME_BUDGET = 12; // ms that a band may take to be drawn while dragging
const PAUSE = 60; // ms without movement after which a band is drawn all the same
const byId = (id) => document.getElementById(id);

class Explorer {
  constructor(run) {
    this.run = run;
    this.experiment = new Experiment(run);
    this.first = firstConditions(run, this.experiment.isCommanded);
    this.conditions = decoded(globalThis.location.hash, this.first, run);
    this.experiment.conditions = this.conditions;
    this.timings = { frame: [], band: [] }; // ms that each took, for the tests
    this.controls = {};
    this.ground = null;
    this.quantities = quantitiesOf(this.experiment);
    if (!this.quantities.has(this.conditions.quantity)) this.conditions.quantity = "distance";
    this.handleUnit = this.handleScale();
    byId("subtitle").textContent = this.subtitle();
    this.buildPanel();
    this.listenToMap();
    new ResizeObserver(() => this.resize()).observe(byId("map"));
    globalThis.addEventListener("hashchange", () => this.takeAddress());
    this.refresh({ map: true });
  }

  subtitle() {
    const { run, tracks, posterior } = this.run;
    const kept = posterior ? ` The posterior has ${this.experiment.posterior.rank} directions.` : " The run has no posterior: paths have no band.";
    const { tableError } = this.run.models[0];
    const table = tableError === undefined ? "" : ` The force is read from a table, whose error is ${shown(100 * tableError)} % of its greatest.`;
    return `Run ${run}, ${tracks.length} ${tracks.length === 1 ? "track" : "tracks"}.${kept}${table} Drag the circle, or click anywhere.`;
  }

  // ---------------------------------------------------------------- conditions

  change(part, { finished = true, map = false } = {}) {
    Object.assign(this.conditions, part);
    this.refresh({ finished, map });
  }

  /** Draw what has changed at the next frame; the band when there is time for it. */
  refresh({ finished = true, map = false } = {}) {
    this.wanted = { finished: finished || this.wanted?.finished, map: map || this.wanted?.map };
    this.request ??= requestAnimationFrame(() => this.frame());
  }

  frame() {
    const { finished, map } = this.wanted;
    this.request = this.wanted = null;
    const begin = performance.now();
    if (map) this.startMap();
    this.computePaths();
    clearTimeout(this.pause);
    const quick = (this.timings.band.at(-1) ?? 0) < FRAME_BUDGET;
    if (finished || quick) this.computeBand();
    else {
      this.band = null;
      this.pause = setTimeout(() => {
        this.computeBand();
        this.draw();
      }, PAUSE);
    }
    if (finished) this.computeDraws();
    else this.drawn = null;
    this.computeRoute(finished);
    this.draw();
    this.showConditions();
    if (!finished) this.timings.frame.push(performance.now() - begin);
    if (finished) this.writeAddress();
  }

  computePaths() {
    const e = this.experiment;
    this.times = e.times();
    this.mean = e.path(e.learned());
    this.physics = this.shows("physics") ? e.path(e.physics()) : null;
    this.truth = this.shows("truth") && e.truth() ? e.path(e.truth()) : null;
  }

  computeBand() {
    if (!this.shows("band") || (!this.experiment.hasPosterior && !(this.conditions.kicks > 0))) {
      this.band = null;
      return;
    }
    const begin = performance.now();
    this.band = this.experiment.band();
    this.timings.band.push(performance.now() - begin);
  }

  /** The way to the goal: at once where the last one was quick, else when let go. */
  computeRoute(finished) {
    const { plan } = this.experiment;
    const wanted = plan && this.shows("plan") && (finished || this.routeTime < FRAME_BUDGET);
    if (!wanted) {
      this.route = null;
      return;
    }
    const begin = performance.now();
    this.route = plan.route(this.experiment.start());
    this.routeTime = performance.now() - begin;
  }

  computeDraws() {
    this.drawn = this.shows("draws") ? this.experiment.draws() : null;
  }

  shows(layer) {
    return this.conditions.show.includes(layer);
  }

  writeAddress() {
    writeAddress(encoded(this.conditions, this.first));
  }

  takeAddress() {
    Object.assign(this.conditions, decoded(globalThis.location.hash, this.first, this.run));
    this.refresh({ map: true });
  }

  // ----------------------------------------------------------------------- map

  resize() {
    this.drawGround();
    this.draw();
  }

  /** Compute the quantity of the map in slices, so that dragging goes on meanwhile. */
  startMap() {
    const quantity = this.quantities.get(this.conditions.quantity);
    clearTimeout(this.mapTimer);
    this.ground = null;
    if (!quantity.at) {
      this.drawGround();
      return;
    }
    const filling = grid(this.run.box, quantity.at(this.conditions.mapTime), quantity.slow ? 61 : 101);
    const slice = () => {
      const begin = performance.now();
      let result = filling.next();
      while (!result.done && performance.now() - begin < 10) result = filling.next();
      if (!result.done) {
        this.mapTimer = setTimeout(slice, 0);
        return;
      }
      const limits = limitsOf(result.value.values, quantity.signed);
      this.ground = { quantity, limits, grid: result.value, image: imageOf(result.value, limits, quantity.signed) };
      this.drawGround();
    };
    slice();
  }

  axisName(name) {
    return this.experiment.units.length ? `${name} [${this.experiment.units.length}]` : name;
  }

  drawGround() {
    const frame = new Frame(byId("ground"), this.run.box);
    frame.clear();
    const { ground } = this;
    if (ground) {
      const [x0, x1, y0, y1] = this.run.box;
      frame.clip((c) => {
        c.imageSmoothingEnabled = true;
        c.drawImage(ground.image, frame.px(x0), frame.py(y1), (x1 - x0) * frame.sx, (y1 - y0) * frame.sy);
      });
    }
    if (this.shows("arrows")) this.drawArrows(frame);
    frame.axes(this.axisName("x"), this.axisName("y"), INK);
    byId("scale").hidden = !ground;
    if (!ground) return;
    const { quantity, limits } = ground;
    drawScale(byId("bar"), quantity.signed);
    byId("low").textContent = shown(limits[0]);
    byId("high").textContent = shown(limits[1]);
    byId("unit").textContent = `${quantity.label}${quantity.unit ? ` [${quantity.unit}]` : ""}`;
  }

  drawArrows(frame) {
    const environment = this.experiment.learned().environment;
    if (!environment) return;
    const [x0, x1, y0, y1] = this.run.box;
    const count = 15;
    const cell = (x1 - x0) / count;
    const arrows = [];
    for (let i = 0; i < count; i++) {
      for (let j = 0; j < count; j++) {
        const x = [x0 + (i + 0.5) * cell, y0 + ((j + 0.5) * (y1 - y0)) / count];
        arrows.push([x, forceAt(environment, this.conditions.mapTime, x)]);
      }
    }
    const most = Math.max(...arrows.map(([, f]) => Math.hypot(...f)));
    if (!(most > 0)) return;
    for (const [[x, y], [fx, fy]] of arrows) {
      // Roots of sizes: weak forces are to be seen beside strong ones.
      const size = Math.hypot(fx, fy);
      const factor = (0.45 * cell * Math.sqrt(size / most)) / (size || 1);
      frame.arrow([x - factor * fx, y - factor * fy], [x + factor * fx, y + factor * fy], through(INK, 0.6), 1.1);
    }
  }

  /** Length on the map of a unit of velocity, or of frequency. */
  handleScale() {
    const { extent, order } = this.run;
    if (order === 2) {
      const speeds = this.run.tracks.map(({ start }) => Math.hypot(start[2], start[3]));
      return (0.15 * extent) / Math.max(...speeds, 1e-9 * extent, 0.5 * this.experiment.typical(2));
    }
    return 0.02 * extent;
  }

  /** The tip of the velocity, or of the command; none where neither is there. */
  tip() {
    const c = this.conditions;
    const k = this.handleUnit;
    if (this.run.order === 2) return [c.x + k * c.vx, c.y + k * c.vy];
    if (!this.experiment.isCommanded || c.replay) return null;
    return [c.x + k * c.frequency * Math.cos(c.heading), c.y + k * c.frequency * Math.sin(c.heading)];
  }

  draw() {
    const frame = (this.mapFrame = new Frame(byId("paths"), this.run.box));
    frame.clear();
    const c = this.conditions;
    const { tracks } = this.experiment;
    const points = (track) => Array.from(track.x, (x, i) => [x, track.y[i]]);
    if (this.shows("tracks")) {
      for (const track of tracks) frame.curve(points(track), MEANING.track, { width: 1, alpha: 0.6 });
    }
    const track = tracks[c.track];
    frame.curve(points(track), PAPER, { width: 4, alpha: 0.8 });
    frame.curve(points(track), MEANING.track, { width: 1.8 });
    if (this.band) this.drawBand(frame);
    for (const path of this.drawn ?? []) frame.curve(path, MEANING.learned, { width: 0.8, alpha: 0.6 });
    if (this.physics) frame.curve(this.physics.states, MEANING.physics, { dash: [2, 4], width: 2.4, casing: true });
    if (this.truth) frame.curve(this.truth.states, MEANING.truth, { width: 4 });
    frame.curve(this.mean.states, MEANING.learned, { width: 2.2, casing: !this.truth });
    if (this.experiment.plan) this.drawPlan(frame);
    if (c.cut) {
      const [x0, y0, x1, y1] = c.cut;
      frame.curve([[x0, y0], [x1, y1]], MEANING.cut, { dash: [7, 4], casing: true });
      frame.dot([x1, y1], MEANING.cut, 6);
    }
    if (this.next) frame.dot([this.next.x, this.next.y], MEANING.next, 8);
    const tip = this.tip();
    if (tip) {
      frame.arrow([c.x, c.y], tip, MEANING.learned, 2.5);
      frame.dot(tip, MEANING.learned, 5);
    }
    frame.dot([c.x, c.y], MEANING.learned, 8, false);
    this.drawPlots();
    this.showReadout();
  }

  /** Goal, walls, the way to the goal, and the trajectory that was suggested. */
  drawPlan(frame) {
    const { goal, tolerance, discs, suggestion } = this.run.plan;
    const circle = ([x, y], radius, stroke, fill) =>
      frame.clip((c) => {
        c.beginPath();
        c.arc(frame.px(x), frame.py(y), radius * frame.sx, 0, 2 * Math.PI);
        c.fillStyle = fill;
        c.strokeStyle = stroke;
        c.lineWidth = 2;
        c.fill();
        c.stroke();
      });
    for (const [x, y, radius] of discs) circle([x, y], radius, MEANING.wall, through(MEANING.wall, 0.5));
    circle(goal, tolerance, MEANING.plan, through(PAPER, 0.8));
    frame.dot(goal, MEANING.plan, 3);
    if (suggestion) frame.curve(suggestion, MEANING.next, { width: 2, dash: [6, 3], casing: true });
    if (this.route) frame.curve(this.route.states, MEANING.plan, { width: 3, casing: true });
  }

  /** The band as ellipses' envelope: edges across the path at each time. */
  drawBand(frame) {
    const { states, sd } = this.band;
    const left = [];
    const right = [];
    for (let i = 0; i < states.length; i++) {
      const [a, b] = [states[Math.max(i - 1, 0)], states[Math.min(i + 1, states.length - 1)]];
      const length = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
      const [nx, ny] = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
      const half = NORMAL_95 * Math.hypot(nx * sd[i][0], ny * sd[i][1]);
      left.push([states[i][0] + half * nx, states[i][1] + half * ny]);
      right.push([states[i][0] - half * nx, states[i][1] - half * ny]);
    }
    frame.area(left, right, MEANING.learned, 0.3);
    const end = states.length - 1;
    frame.clip((c) => {
      c.strokeStyle = MEANING.learned;
      c.lineWidth = 1.2;
      c.beginPath();
      const [rx, ry] = sd[end].map((one, d) => Math.min(NORMAL_95 * one * (d ? frame.sy : frame.sx), 1e4));
      c.ellipse(frame.px(states[end][0]), frame.py(states[end][1]), rx, ry, 0, 0, 2 * Math.PI);
      c.stroke();
    });
  }

  drawPlots() {
    const time = this.experiment.units.time;
    const horizontal = time ? `t [${time}]` : "t";
    const track = this.experiment.tracks[this.conditions.track];
    const { from, duration } = this.conditions;
    ["x", "y"].forEach((name, d) => {
      const over = ({ states }, times = this.times) => states.map((state, i) => [times[i], state[d]]);
      const observed = Array.from(track.times, (t, i) => [t, track[name][i]]);
      const curves = [];
      if (this.followsTrack()) {
        const points = observed.filter(([t]) => t >= from && t <= from + duration);
        if (points.length) curves.push({ points, colour: MEANING.track, dots: true });
      }
      if (this.physics) curves.push({ points: over(this.physics), colour: MEANING.physics, dash: [2, 4] });
      if (this.truth) curves.push({ points: over(this.truth), colour: MEANING.truth, width: 3.5 });
      if (this.band) {
        curves.push({ points: over(this.band, this.band.times), sd: this.band.sd.map((one) => one[d]), colour: MEANING.learned });
      } else curves.push({ points: over(this.mean), colour: MEANING.learned });
      plot(byId(`plot-${name}`), curves, [horizontal, this.axisName(name)], INK);
    });
    this.drawCut();
  }

  /** The start is that of the chosen track, so that its samples may stand beside. */
  followsTrack() {
    const c = this.conditions;
    const { start, from } = this.run.tracks[c.track];
    const state = this.experiment.start();
    return c.from === from && start.every((value, i) => Math.abs(value - state[i]) <= 1e-9 * this.run.extent);
  }

  drawCut() {
    const { cut } = this.conditions;
    byId("cut").hidden = !cut || !this.experiment.learned().environment;
    if (byId("cut").hidden) return;
    const points = this.experiment.cut(cut, forceAt, forceSd);
    const angle = Math.atan2(cut[3] - cut[1], cut[2] - cut[0]);
    const along = ([fx, fy]) => fx * Math.cos(angle) + fy * Math.sin(angle);
    const spread = ([sx, sy]) => Math.hypot(sx * Math.cos(angle), sy * Math.sin(angle));
    const curves = [
      {
        points: points.map(({ place, mean }) => [place, along(mean)]),
        sd: points.map(({ sd }) => spread(sd)),
        colour: MEANING.learned,
      },
    ];
    if (points[0].truth) {
      const truth = points.map(({ place, truth: force }) => [place, along(force)]);
      curves.unshift({ points: truth, colour: MEANING.truth, width: 3.5 });
    }
    const { force, length } = this.experiment.units;
    const names = [`along the cut${length ? ` [${length}]` : ""}`, `force along it${force ? ` [${force}]` : ""}`];
    plot(byId("plot-cut"), curves, names, INK);
  }

  showReadout() {
    const { states, finite } = this.mean;
    const [x, y] = states.at(-1);
    const { length } = this.experiment.units;
    const unit = length ? ` ${length}` : "";
    const sd = this.band?.sd.at(-1);
    const within = (i) => (sd ? ` ± ${shown(NORMAL_95 * sd[i], 2)}` : "");
    const end = `The path ends at x = ${shown(x, 4)}${within(0)}, y = ${shown(y, 4)}${within(1)}${unit}`;
    const parts = [finite ? `${end}${sd ? " (95 %)" : ""}.` : "The path diverges."];
    if (this.route) {
      const time = this.experiment.units.time;
      const arrives = `The plan reaches the goal after ${shown(this.route.arrival, 3)}${time ? ` ${time}` : ""}.`;
      parts.unshift(Number.isFinite(this.route.arrival) ? arrives : "From here the plan does not reach the goal in time.");
    }
    if (this.next) parts.push(`Record next from the green dot: ${shown(this.next.gain)} nats.`);
    if (this.suggesting) parts.push(`Weighing starts: ${Math.round(100 * this.suggesting)} %.`);
    byId("readout").textContent = parts.join(" ");
    this.showLegend();
  }

  showLegend() {
    const entries = [["learned model", MEANING.learned, ""]];
    if (this.band) entries.push(["95 % band", MEANING.learned, "wide"]);
    if (this.physics) entries.push(["physics alone", MEANING.physics, "dotted"]);
    if (this.truth) entries.push(["truth", MEANING.truth, ""]);
    entries.push([`track ${this.run.tracks[this.conditions.track].index}`, MEANING.track, ""]);
    if (this.route) entries.push(["plan", MEANING.plan, ""]);
    if (this.run.plan?.suggestion) entries.push(["record next", MEANING.next, "dashed"]);
    if (this.conditions.cut) entries.push(["cut", MEANING.cut, "dashed"]);
    const key = entries.map(String).join();
    if (key === this.legendKey) return;
    this.legendKey = key;
    showLegend(entries);
  }

  // ------------------------------------------------------------------ gestures

  listenToMap() {
    listen(byId("paths"), () => this.handles(), {
      empty: () => (this.cutting ? "cut" : "start"),
      grab: (name, place) => {
        if (name !== "cut") return;
        const at = this.mapFrame.place(...place);
        const old = this.conditions.cut;
        const keeps = old && !this.cutting;
        this.conditions.cut = keeps ? old : [...at, ...at];
      },
      move: (name, place) => this.moveHandle(name, this.mapFrame.place(...place)),
      release: () => this.change({}),
      key: (name, [dx, dy]) => {
        const step = 0.01 * (this.run.box[1] - this.run.box[0]);
        const c = this.conditions;
        const at = name === "velocity" ? this.tip() : [c.x, c.y];
        if (at) this.moveHandle(name, [at[0] + step * dx, at[1] + step * dy], true);
      },
    });
  }

  handles() {
    const { mapFrame: frame, conditions: c } = this;
    const pixel = ([x, y]) => [frame.px(x), frame.py(y)];
    const list = [{ name: "start", at: pixel([c.x, c.y]) }];
    const tip = this.tip();
    if (tip) list.push({ name: "velocity", at: pixel(tip) });
    if (c.cut) list.push({ name: "cut", at: pixel(c.cut.slice(2)) });
    return this.cutting ? [] : list;
  }

  moveHandle(name, [x, y], finished = false) {
    const c = this.conditions;
    const k = this.handleUnit;
    if (name === "start") this.change({ x, y }, { finished });
    else if (name === "cut") this.change({ cut: [...c.cut.slice(0, 2), x, y] }, { finished });
    else if (this.run.order === 2) this.change({ vx: (x - c.x) / k, vy: (y - c.y) / k }, { finished });
    else {
      const frequency = Math.hypot(x - c.x, y - c.y) / k;
      this.change({ frequency, heading: Math.atan2(y - c.y, x - c.x) }, { finished });
    }
  }

  // --------------------------------------------------------------------- panel

  buildPanel() {
    byId("panel").append(
      this.startGroup(),
      this.commandGroup(),
      this.mapGroup(),
      this.trackGroup(),
      this.takeAwayGroup(),
    );
  }

  startGroup() {
    const { length, time } = this.experiment.units;
    const unit = (text) => (text ? ` [${text}]` : "");
    const speed = length && time ? `${length}/${time}` : "";
    const names = this.run.order === 2 ? ["x", "y", "vx", "vy"] : ["x", "y"];
    const fields = names.map((name) => {
      const label = `${name}${unit(name.startsWith("v") ? speed : length)}`;
      return (this.controls[name] = numberField(label, (value) => this.change({ [name]: value })));
    });
    const [first, last] = this.run.clock;
    const range = { low: (last - first) / 100, high: 2 * (last - first), step: "any" };
    this.controls.duration = slider(`duration${unit(time)}`, range, (duration, finished) => this.change({ duration }, { finished }));
    const from = { low: first, high: last, step: "any" };
    this.controls.from = slider(`release at t${unit(time)}`, from, (value, finished) => this.change({ from: value }, { finished }));
    const timed = this.experiment.learned().timed;
    const rows = [make("div", { class: "numbers" }, ...fields), this.controls.duration];
    return group("Start", ...rows, ...(timed ? [this.controls.from] : []));
  }

  commandGroup() {
    const rows = this.experiment.isCommanded ? this.rollingRows() : this.thrustRows();
    const { length, time } = this.experiment.units;
    const most = 4 * this.run.kicks || 0.1 * (this.run.order === 2 ? this.experiment.typical(2) : this.run.extent);
    const unit = length && time ? ` [${length}/√${time}]` : "";
    const noise = { low: 0, high: most, step: "any" };
    this.controls.kicks = slider(`noise √(2D)${unit}`, noise, (kicks, finished) => this.change({ kicks }, { finished }));
    return group("Commands and noise", ...rows, this.controls.kicks);
  }

  rollingRows() {
    const { response } = this.run;
    const frequencies = arrayOf(response.frequencies);
    const speeds = arrayOf(response.speeds);
    const most = frequencies.at(-1);
    this.handleUnit = (0.3 * this.run.extent) / most;
    const constant = (part, finished) => this.change({ ...part, replay: false }, { finished });
    const range = { low: 0, high: most, step: "any" };
    this.controls.frequency = slider("frequency [Hz]", range, (frequency, done) => constant({ frequency }, done));
    const turn = { low: -180, high: 180, step: "any" };
    this.controls.heading = slider("heading [°]", turn, (angle, done) => constant({ heading: (angle * Math.PI) / 180 }, done));
    this.controls.replay = checks([["replay", "commands as recorded"]], (_, replay) => this.change({ replay }));
    const small = make("canvas", { class: "small", role: "img", "aria-label": "Speed over frequency" });
    const speedAt = (frequency) => {
      const place = Math.min(Math.max(frequency / frequencies[1], 0), speeds.length - 1);
      const [index, share] = [Math.min(Math.floor(place), speeds.length - 2), place % 1];
      return place === speeds.length - 1 ? speeds.at(-1) : speeds[index] + share * (speeds[index + 1] - speeds[index]);
    };
    this.drawResponse = () => {
      const points = Array.from(frequencies, (frequency, i) => [frequency, speeds[i]]);
      const now = this.conditions.frequency;
      const { length } = this.experiment.units;
      const curves = [{ points, colour: MEANING.learned }];
      if (!this.conditions.replay) curves.push({ points: [[now, 0], [now, speedAt(now)]], colour: MEANING.plan, dash: [3, 3] });
      const { corner } = response;
      if (corner !== null && corner < most) curves.push({ points: [[corner, 0], [corner, speedAt(corner)]], colour: MEANING.physics, dash: [1, 3] });
      plot(small, curves, ["frequency [Hz]", length ? `speed [${length}/s]` : "speed"], INK);
    };
    const corner = response.corner === null ? "" : ` The dotted line is its corner, ${shown(response.corner)} Hz.`;
    const hint = make("p", { class: "hint" }, `Response: ${response.name}.${corner}`);
    const rows = [this.controls.frequency, this.controls.heading, small, hint];
    return this.run.tracks.some((track) => track.commands) ? [this.controls.replay, ...rows] : rows;
  }

  thrustRows() {
    if (!this.run.hasThrust) return [];
    this.controls.thrust = slider("thrust [× stated]", { low: 0, high: 3, step: "any" }, (thrust, finished) => this.change({ thrust }, { finished }));
    const turn = { low: -180, high: 180, step: "any" };
    this.controls.turn = slider("heading, turned by [°]", turn, (angle, finished) => this.change({ turn: (angle * Math.PI) / 180 }, { finished }));
    return [this.controls.thrust, this.controls.turn];
  }

  mapGroup() {
    const options = [...this.quantities].map(([name, { label }]) => [name, label]);
    this.controls.quantity = choice("shows", options, (quantity) => this.change({ quantity }, { map: true }));
    const rows = [this.controls.quantity];
    if (this.run.models.length > 1) {
      const models = this.run.models.map(({ name }, i) => [i, name]);
      this.controls.model = choice("model", models, (text) => {
        this.conditions.model = Number(text);
        this.change({}, { map: true });
      });
      rows.push(this.controls.model);
    }
    if (this.experiment.learned().timed && this.experiment.learned().environment) {
      const [low, high] = this.run.clock;
      const time = this.experiment.units.time;
      const label = `time of the map${time ? ` [${time}]` : ""}`;
      this.controls.mapTime = slider(label, { low, high, step: "any" }, (mapTime) => this.change({ mapTime }, { map: true }));
      rows.push(this.controls.mapTime);
    }
    const layers = Object.entries(LAYERS).filter(([name]) => (name !== "truth" || this.run.truth) && (name !== "plan" || this.run.plan));
    this.controls.show = checks(layers, (name, on) => {
      const show = this.conditions.show.filter((one) => one !== name);
      this.change({ show: on ? [...show, name] : show });
      this.drawGround();
    });
    this.cutButton = button("Draw a cut", () => this.toggleCut(), { "aria-pressed": "false" });
    this.nextButton = button("Record here next", () => this.suggest());
    const tools = make("div", { class: "buttons" }, this.cutButton);
    if (this.experiment.posterior && this.run.noise > 0) tools.append(this.nextButton);
    return group("Map", ...rows, this.controls.show, tools);
  }

  /** The next drag draws a cut; with one there, the button removes it. */
  toggleCut() {
    const { cut } = this.conditions;
    if (cut) this.change({ cut: null });
    else if (this.cutting) this.cutting = false;
    else {
      this.cutting = true;
      // Keyboard alone: a cut across the middle, which the address can move.
      const [x0, x1, y0, y1] = this.run.box;
      this.change({ cut: [x0, (y0 + y1) / 2, x1, (y0 + y1) / 2] });
    }
  }

  suggest() {
    const search = this.experiment.recordNext();
    const slice = () => {
      const begin = performance.now();
      let step = search.next();
      while (!step.done && performance.now() - begin < 12) step = search.next();
      this.suggesting = step.done ? 0 : step.value.done;
      this.next = step.done ? step.value : step.value.best;
      this.draw();
      if (!step.done) setTimeout(slice, 0);
    };
    slice();
  }

  trackGroup() {
    const options = this.run.tracks.map((track, i) => [i, `track ${track.index}, ${track.times.shape[0]} samples`]);
    this.controls.track = choice("overlay", options, (text) => this.goToTrack(Number(text)));
    const step = (by) => () => {
      const count = this.run.tracks.length;
      this.goToTrack((this.conditions.track + by + count) % count);
    };
    const buttons = [button("previous", step(-1)), button("next", step(1))];
    return group("Data", this.controls.track, make("div", { class: "buttons" }, ...buttons));
  }

  /** Start where a track started, under its commands. */
  goToTrack(track) {
    const { start, from, to, commands } = this.run.tracks[track];
    const [x, y, vx = 0, vy = 0] = start;
    const duration = Math.min(to - from, this.first.duration > 0 && commands ? Math.max(this.first.duration, 60) : Infinity);
    this.change({ track, x, y, vx, vy, from, duration, replay: Boolean(commands) });
  }

  takeAwayGroup() {
    const name = this.run.run.replace(/[^\w-]+/g, "-");
    const picture = button("Picture", () => savePicture(`${name}.png`, [byId("ground"), byId("paths")]));
    const table = button("Path as CSV", () => saveText(`${name}-path.csv`, this.table()));
    const again = button("As at first", () => {
      Object.assign(this.conditions, structuredClone(this.first));
      this.next = null;
      this.change({}, { map: true });
    });
    const hint = make("p", { class: "hint" }, "The address holds all conditions: copy it to share what you see.");
    return group("Take away", make("div", { class: "buttons" }, picture, table, again), hint);
  }

  table() {
    return pathTable(this.experiment.band(), this.run.units);
  }

  showConditions() {
    const c = this.conditions;
    for (const [name, control] of Object.entries(this.controls)) {
      if (name === "heading" || name === "turn") control.set((c[name] * 180) / Math.PI);
      else if (name === "replay") control.set(c.replay ? ["replay"] : []);
      else control.set(c[name]);
    }
    this.drawResponse?.();
    if (!c.cut) this.cutting = false;
    this.cutButton.setAttribute("aria-pressed", String(Boolean(c.cut)));
    this.cutButton.textContent = c.cut ? "Remove the cut" : "Draw a cut";
  }
}

function begin() {
  try {
    const run = JSON.parse(byId("run").textContent);
    // For those who ask in the console, and for the tests.
    const Page = { tissue: HeatExplorer, sections: SectionExplorer }[run.kind] ?? Explorer;
    const page = new Page(run);
    globalThis.explorer = page;
  } catch (error) {
    const note = byId("failure");
    note.hidden = false;
    note.textContent = `The numbers in this file cannot be shown (${error.message}); write it again with pinav explore.`;
  }
}

begin();
