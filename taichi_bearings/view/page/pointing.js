/** Pointing, clicking and keys on the picture. */
function listenToCanvas(sample, picture) {
  const { canvas } = picture, panel = element("numbers");
  let kept = false, waiting = null, pressed = null;
  const tell = (found, x, y) => {
    panel.hidden = found === null;
    picture.mark(found);
    picture.draw();
    if (!found) return;
    const { title, rows } = numbersOf(sample, found), table = document.createElement("table");
    for (const [name, value] of rows) {
      const row = table.insertRow();
      row.append(Object.assign(document.createElement("th"), { textContent: name, scope: "row" }));
      row.insertCell().textContent = value;
    }
    panel.replaceChildren(Object.assign(document.createElement("b"), { textContent: title }), table);
    panel.style.left = `${Math.min(x + 16, canvas.clientWidth - panel.offsetWidth - 8)}px`;
    panel.style.top = `${canvas.parentElement.offsetTop + Math.max(8, Math.min(y + 16, canvas.clientHeight - panel.offsetHeight - 8))}px`;
  };
  const keep = (found, x, y) => { kept = found !== null; panel.classList.toggle("kept", kept); tell(found, x, y); };
  canvas.addEventListener("pointermove", (event) => {
    if (kept || event.buttons) return;
    const { offsetX: x, offsetY: y } = event;
    if (!waiting) waiting = requestAnimationFrame(() => { waiting = null; if (!kept) tell(picture.pick(x, y), x, y); });
  });
  canvas.addEventListener("pointerleave", () => { if (!kept) tell(null); });
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.offsetX, event.offsetY]; });
  canvas.addEventListener("pointerup", ({ offsetX: x, offsetY: y }) => {
    if (pressed && Math.hypot(x - pressed[0], y - pressed[1]) < 4) keep(picture.pick(x, y), x, y);
    pressed = null;
  });
  const middle = () => [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const keys = {
    ArrowLeft: () => picture.turn(-0.1, 0), ArrowRight: () => picture.turn(0.1, 0), ArrowUp: () => picture.turn(0, 0.1),
    ArrowDown: () => picture.turn(0, -0.1), "+": () => picture.zoom(0.9), "=": () => picture.zoom(0.9), "-": () => picture.zoom(1 / 0.9),
    Home: () => picture.firstView(), p: () => keep(picture.pick(...middle()), ...middle()), Escape: () => keep(null),
  };
  canvas.addEventListener("keydown", (event) => {
    const act = event.ctrlKey || event.metaKey || event.altKey ? null : keys[event.key];
    if (act) { event.preventDefault(); act(); }
  });
  new ResizeObserver(() => picture.draw()).observe(canvas);
}
