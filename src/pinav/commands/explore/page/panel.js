// Controls: native inputs, so that keyboard, touch and screen readers work as anywhere.

/** An element with attributes and children. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

let serial = 0;

/** A group of controls under a heading. */
export function group(title, ...children) {
  return make("section", { class: "group" }, make("h2", {}, title), ...children);
}

/**
 * A number with a slider beside it.
 *
 * @param range {low, high, step}; the number itself may lie outside.
 * @param change(value, finished) while it is dragged, and when it is let go.
 * @returns the row, with `set(value)`.
 */
export function slider(label, range, change) {
  const id = `control-${serial++}`;
  const slide = make("input", { type: "range", min: range.low, max: range.high, step: range.step, "aria-label": label });
  const number = make("input", { type: "number", id, step: "any" });
  slide.addEventListener("input", () => change(Number(slide.value), false));
  slide.addEventListener("change", () => change(Number(slide.value), true));
  number.addEventListener("change", () => {
    if (number.value !== "" && Number.isFinite(Number(number.value))) change(Number(number.value), true);
  });
  const row = make("div", { class: "row" }, make("label", { for: id }, label), make("div", { class: "pair" }, slide, number));
  row.set = (value) => {
    slide.value = value;
    if (document.activeElement !== number) number.value = Number(value.toPrecision(5));
  };
  return row;
}

/** A number alone. */
export function numberField(label, change) {
  const id = `control-${serial++}`;
  const number = make("input", { type: "number", id, step: "any" });
  number.addEventListener("change", () => {
    if (number.value !== "" && Number.isFinite(Number(number.value))) change(Number(number.value));
  });
  const row = make("div", { class: "row" }, make("label", { for: id }, label), number);
  row.set = (value) => {
    if (document.activeElement !== number) number.value = Number(value.toPrecision(5));
  };
  return row;
}

/** A choice among [value, text] pairs. */
export function choice(label, options, change) {
  const id = `control-${serial++}`;
  const select = make("select", { id }, ...options.map(([value, text]) => make("option", { value }, text)));
  select.addEventListener("change", () => change(select.value));
  const row = make("div", { class: "row" }, make("label", { for: id }, label), select);
  row.set = (value) => {
    select.value = value;
  };
  return row;
}

/** Boxes to tick, by name. */
export function checks(options, change) {
  const boxes = new Map();
  const labels = options.map(([name, text]) => {
    const box = make("input", { type: "checkbox" });
    box.addEventListener("change", () => change(name, box.checked));
    boxes.set(name, box);
    return make("label", {}, box, text);
  });
  const row = make("div", { class: "checks" }, ...labels);
  row.set = (names) => boxes.forEach((box, name) => (box.checked = names.includes(name)));
  return row;
}

/** What the colours mean, as [text, colour, look] triples under the map. */
export function showLegend(entries) {
  const samples = entries.map(([text, colour, look = ""]) => {
    const sample = make("i", { class: look });
    sample.style.color = colour;
    return make("span", {}, sample, make("b", {}, text));
  });
  document.getElementById("legend").replaceChildren(...samples);
}

export function button(text, press, attributes = {}) {
  return make("button", { type: "button", ...attributes, onclick: press }, text);
}
