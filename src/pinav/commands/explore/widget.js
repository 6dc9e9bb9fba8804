// The page in a frame of a notebook; its conditions are shared with Python.

function render({ model, el }) {
  const frame = document.createElement("iframe");
  frame.title = "Explorer";
  frame.srcdoc = model.get("page");
  Object.assign(frame.style, { width: "100%", height: model.get("height"), border: "0" });
  const address = () => frame.contentWindow.location.hash.slice(1);
  const move = () => {
    if (frame.contentWindow?.explorer && model.get("address") !== address()) {
      frame.contentWindow.location.hash = model.get("address");
    }
  };
  frame.addEventListener("load", () => {
    frame.contentWindow.addEventListener("conditions", () => {
      model.set("address", address());
      model.set("path", frame.contentWindow.explorer.table());
      model.save_changes();
    });
    frame.contentWindow.explorer?.refresh();
    move();
  });
  model.on("change:address", move);
  el.append(frame);
  return () => model.off("change:address", move);
}

export default { render };
