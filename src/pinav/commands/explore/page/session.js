// The conditions that the reader sets, and their way into the address and back.

const SHORT = {
  model: "m",
  quantity: "q",
  x: "x",
  y: "y",
  vx: "vx",
  vy: "vy",
  from: "t0",
  duration: "T",
  track: "k",
  replay: "replay",
  frequency: "f",
  heading: "h",
  thrust: "a",
  turn: "r",
  kicks: "s",
  mapTime: "t",
  cut: "cut",
  show: "show",
};

/** What is drawn besides the mean path. */
export const LAYERS = {
  band: "95 % band",
  draws: "draws",
  physics: "physics alone",
  truth: "truth",
  plan: "plan to the goal",
  tracks: "all tracks",
  arrows: "arrows",
};

const degrees = (angle) => (angle * 180) / Math.PI;
const radians = (angle) => (angle * Math.PI) / 180;
const ANGLES = new Set(["heading", "turn"]);

/** Conditions of a page that was just opened: the start of the first track. */
export function firstConditions(run, commanded) {
  const track = run.tracks[0];
  const [x, y, vx = 0, vy = 0] = run.plan ? run.plan.start : track.start;
  const plain = run.hasForce ? "force" : "distance";
  return {
    model: 0,
    quantity: run.plan ? "go" : plain,
    ...{ x, y, vx, vy },
    from: track.from,
    duration: Math.min(track.to - track.from, commanded ? 60 : Infinity),
    track: 0,
    replay: Boolean(commanded && track.commands),
    frequency: commanded ? 1 : 0,
    heading: 0,
    thrust: 1,
    turn: 0,
    kicks: run.kicks,
    mapTime: run.clock[0],
    cut: null,
    show: run.plan ? ["plan", "arrows"] : ["band", "physics", "truth", "arrows"],
  };
}

/** Conditions as the text after # in the address; what is as at first is left out. */
export function encoded(conditions, first) {
  const parts = [];
  for (const [name, short] of Object.entries(SHORT)) {
    const value = conditions[name];
    if (JSON.stringify(value) === JSON.stringify(first[name])) continue;
    parts.push(`${short}=${encodeURIComponent(written(name, value))}`);
  }
  return parts.join("&");
}

function written(name, value) {
  if (value === null) return "";
  if (typeof value === "boolean") return value ? "1" : "0";
  if (Array.isArray(value)) return value.map((part) => written("", part)).join(",");
  if (typeof value !== "number") return value;
  return String(Number((ANGLES.has(name) ? degrees(value) : value).toPrecision(6)));
}

/** Conditions from such a text; whatever makes no sense is as at first. */
export function decoded(text, first, run) {
  const conditions = { ...first };
  const given = new URLSearchParams(text.replace(/^#/, ""));
  for (const [name, short] of Object.entries(SHORT)) {
    if (!given.has(short)) continue;
    const value = read(name, given.get(short), first[name]);
    if (value !== undefined) conditions[name] = value;
  }
  conditions.model = within(conditions.model, run.models.length);
  conditions.track = within(conditions.track, run.tracks.length);
  conditions.duration = Math.max(conditions.duration, 1e-6);
  return conditions;
}

const within = (index, count) => (Number.isInteger(index) && index >= 0 && index < count ? index : 0);

function read(name, text, first) {
  if (name === "show") return text.split(",").filter((layer) => layer in LAYERS);
  if (name === "cut") {
    const ends = text.split(",").map(Number);
    return ends.length === 4 && ends.every(Number.isFinite) ? ends : null;
  }
  if (typeof first === "boolean") return text === "1";
  if (typeof first === "string") return text;
  const value = Number(text);
  if (text === "" || !Number.isFinite(value)) return undefined;
  return ANGLES.has(name) ? radians(value) : value;
}
