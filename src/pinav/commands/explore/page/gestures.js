// Pointer and keyboard on the map: drag the start, the velocity, or a cut.

const REACH = 26; // pixels within which a handle is taken; fingers are wide

/**
 * @param handles() gives [{name, at: [px, py]}], nearest to the reader's intent first.
 * @param on {move(name, [px, py]), release(name), key(name, [dx, dy])}
 */
export function listen(canvas, handles, on) {
  let held = null;
  const at = (event) => {
    const bounds = canvas.getBoundingClientRect();
    return [event.clientX - bounds.left, event.clientY - bounds.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const place = at(event);
    const far = ({ at: [x, y] }) => Math.hypot(x - place[0], y - place[1]);
    const near = handles().filter((handle) => far(handle) < REACH);
    near.sort((a, b) => far(a) - far(b));
    held = event.altKey ? "cut" : (near[0]?.name ?? on.empty());
    canvas.setPointerCapture(event.pointerId);
    on.grab(held, place);
    on.move(held, place);
    event.preventDefault();
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener("pointermove", (event) => {
    if (held) on.move(held, at(event));
  });
  const release = () => {
    if (held) on.release(held);
    held = null;
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  canvas.addEventListener("keydown", (event) => {
    const step = arrows[event.key];
    if (!step) return;
    const size = event.ctrlKey || event.metaKey ? 0.1 : 1;
    on.key(event.shiftKey ? "velocity" : "start", step.map((part) => size * part));
    event.preventDefault();
  });
}
