// Colours that colour-blind readers tell apart; one colour for one meaning, as in figures.

export const MEANING = {
  learned: "#0072B2",
  physics: "#5F5F5F",
  truth: "#000000",
  track: "#D55E00",
  cut: "#CC79A7",
  next: "#009E73",
  plan: "#E69F00",
  target: "#56B4E9",
  wall: "#404040",
};

/** Curves of bioheat. */
export const HEATING = {
  hottest: "#D55E00",
  T90: "#E69F00",
  D90: "#E69F00",
  probe: "#009E73",
  outside: "#5F5F5F",
  field: "#000000",
  here: "#0072B2",
  asRun: "#5F5F5F",
};

/** Of axes and their texts. */
export const INK = "#3a424b";

/** Of the ground, and of what keeps curves apart from what lies below them. */
export const PAPER = "#FFFFFF";

/** A colour through which what lies below is seen. */
export function through(colour, share) {
  return colour + Math.round(255 * share).toString(16).padStart(2, "0");
}

/** Cividis from pale to dark, and blue to orange through white for signed numbers. */
const SEQUENTIAL = ["#fffde9", "#fdea45", "#c9ba66", "#94906f", "#6b6d72", "#434e6c", "#00224e"];
const SIGNED = ["#0b4f8a", "#4b93c8", "#a9cfe8", "#f7f7f7", "#f9c98b", "#e28a2b", "#8f4a00"];

/** A table of 256 colours as [r, g, b]. */
function tableOf(stops) {
  const colours = stops.map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
  return Array.from({ length: 256 }, (_, i) => {
    const place = (i / 255) * (colours.length - 1);
    const below = Math.min(Math.floor(place), colours.length - 2);
    const share = place - below;
    return [0, 1, 2].map((c) =>
      Math.round(colours[below][c] + share * (colours[below + 1][c] - colours[below][c])),
    );
  });
}

const TABLES = { sequential: tableOf(SEQUENTIAL), signed: tableOf(SIGNED) };

/** The colour of a share of the scale, from 0 to 1. */
export function colourOf(share, signed) {
  const index = Math.min(Math.max(Math.round(share * 255), 0), 255);
  return TABLES[signed ? "signed" : "sequential"][index];
}
