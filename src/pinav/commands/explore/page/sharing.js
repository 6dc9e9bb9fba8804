// What the reader takes away: the address, a picture of the map, the path as a table.

import { PAPER } from "./colours.js";

/** Put the conditions into the address, after its #, without a step of the history. */
export function writeAddress(text) {
  // Whole, because "#..." of a frame in a notebook is one of the notebook's address.
  const [page] = globalThis.location.href.split("#");
  if (text !== globalThis.location.hash.slice(1)) history.replaceState(null, "", text ? `${page}#${text}` : page);
  globalThis.dispatchEvent(new Event("conditions")); // for a notebook around the page
}

function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Several canvases of one size, one over the other, as a PNG. */
export function savePicture(name, canvases) {
  const whole = document.createElement("canvas");
  [whole.width, whole.height] = [canvases[0].width, canvases[0].height];
  const c = whole.getContext("2d");
  c.fillStyle = PAPER;
  c.fillRect(0, 0, whole.width, whole.height);
  for (const canvas of canvases) c.drawImage(canvas, 0, 0);
  whole.toBlob((blob) => save(name, blob), "image/png");
}

/** The path with its standard deviations as CSV text. */
export function pathTable({ times, states, sd }, units) {
  const unit = (name) => (units[name] && units[name] !== "1" ? ` [${units[name]}]` : "");
  const names = ["x", "y", "vx", "vy"].slice(0, states[0].length);
  const header = ["t", ...names].map((name) => name + unit(name));
  const spreads = ["x", "y"].map((name) => `sd ${name}${unit(name)}`);
  const rows = states.map((state, i) => [times[i], ...state, ...sd[i]].join(","));
  return [[...header, ...spreads].join(","), ...rows, ""].join("\n");
}

export function saveText(name, text) {
  save(name, new Blob([text], { type: "text/csv" }));
}
