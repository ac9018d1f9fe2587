// Zoom and cursor that plots over time share; definitions beside names. Runs once the page is loaded.
(() => {
  const all = [...document.querySelectorAll(".js-plotly-plot")];
  const title = plot => plot.layout?.xaxis?.title?.text;
  const timed = all.filter(plot => title(plot) === "time [s]");

  // a finger scrolls the page; the buttons above a plot still zoom
  if (matchMedia("(pointer: coarse)").matches) for (const plot of all) Plotly.relayout(plot, { dragmode: false });

  let linking = false;
  const follow = async (plot, change) => {
    if (linking) return;
    const range = change["xaxis.range"] ?? [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const update = change["xaxis.autorange"] ? { "xaxis.autorange": true }
      : range.every(v => v !== undefined) ? { "xaxis.range": [...range] } : null;
    if (!update) return;
    linking = true;
    try { await Promise.all(timed.filter(other => other !== plot).map(other => Plotly.relayout(other, update))); }
    finally { linking = false; }
  };

  const cursors = new Map(timed.map(plot => {
    const line = document.createElement("div");
    line.className = "cursor";
    line.hidden = true;
    plot.append(line);
    return [plot, line];
  }));
  const point = (from, x) => {
    for (const [plot, line] of cursors) {
      const { xaxis, _size } = plot._fullLayout, at = xaxis.l2p(x);
      line.hidden = plot === from || x === undefined || !(at >= 0 && at <= xaxis._length);
      Object.assign(line.style, { left: `${xaxis._offset + at}px`, top: `${_size.t}px`, height: `${_size.h}px` });
    }
  };
  for (const plot of timed) {
    plot.on("plotly_relayout", change => follow(plot, change));
    plot.on("plotly_hover", event => point(plot, event.xvals?.[0] ?? event.points[0]?.x));
    plot.on("plotly_unhover", () => point(plot, undefined));
    plot.on("plotly_click", event => document.dispatchEvent(new CustomEvent("replay-seek", { detail: event.xvals?.[0] ?? event.points[0]?.x })));
  }

  document.addEventListener("replay-time", event => point(null, event.detail));

  const tip = document.createElement("div");
  tip.id = "tip";
  tip.setAttribute("role", "tooltip");
  tip.hidden = true;
  document.body.append(tip);
  let named = null;
  const about = event => {
    const name = event.type === "keydown" ? null : event.target.closest?.("[data-about]") ?? null;
    if (event.type === "keydown" && event.key !== "Escape" || name === named) return;
    named?.removeAttribute("aria-describedby");
    named = name;
    tip.hidden = !name;
    if (!name) return;
    tip.textContent = name.dataset.about;
    name.setAttribute("aria-describedby", "tip");
    const box = name.getBoundingClientRect();
    tip.style.left = `${Math.max(8, Math.min(box.left, innerWidth - tip.offsetWidth - 8))}px`;
    const below = box.bottom + 6;
    tip.style.top = `${below + tip.offsetHeight < innerHeight ? below : box.top - tip.offsetHeight - 6}px`;
  };
  for (const kind of ["mouseover", "focusin", "click", "keydown"]) document.addEventListener(kind, about);
  addEventListener("scroll", () => { tip.hidden = true; named = null }, { passive: true });

  dispatchEvent(new Event("resize"));
})();
