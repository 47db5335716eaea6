"use strict";
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const coloured = (value) => {
    if (typeof value === "string") return value.startsWith("var(--") ? variable(value.slice(4, -1)) : value;
    if (Array.isArray(value)) return value.map(coloured);
    if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, coloured(v)]));
    return value;
  };
  const read = (figure) => JSON.parse(document.getElementById(figure.dataset.plot).textContent);
  const axis = (given) => ({ gridcolor: variable("--line"), zerolinecolor: variable("--soft"), zerolinewidth: 1, linecolor: variable("--line"), automargin: true, ...given });
  const layout = (given, height, narrow) => {
    const found = { font: { family: "system-ui, sans-serif", size: 12, color: variable("--ink") }, paper_bgcolor: variable("--paper"), plot_bgcolor: variable("--paper"),
      margin: { l: 55, r: 12, t: 8, b: 42 }, hoverlabel: { bgcolor: variable("--panel"), bordercolor: variable("--soft"), font: { color: variable("--ink") }, namelength: -1 },
      legend: { orientation: "h", x: 0, y: 1 + 6 / Math.max(height - 60, 60), yanchor: "bottom" }, ...coloured(given) };
    if (found.scene) {
      for (const name of ["xaxis", "yaxis", "zaxis"]) found.scene[name] = { backgroundcolor: variable("--panel"), ...axis(found.scene[name]) };
    } else {
      found.xaxis = axis(found.xaxis);
      found.yaxis = axis(found.yaxis);
      if (narrow) found.xaxis.tickfont = found.yaxis.tickfont = { size: 10 };
    }
    return found;
  };
  const globe = () => {
    const path = [[], [], []];
    const circle = (point) => {
      for (let k = 0; k <= 36; k += 1) point(k * Math.PI / 18).forEach((v, i) => path[i].push(v));
      path.forEach((part) => part.push(null));
    };
    for (const level of [-60, -30, 0, 30, 60].map((d) => d * Math.PI / 180)) circle((t) => [Math.cos(level) * Math.cos(t), Math.cos(level) * Math.sin(t), Math.sin(level)]);
    for (const around of [0, 30, 60, 90, 120, 150].map((d) => d * Math.PI / 180)) circle((t) => [Math.cos(t) * Math.cos(around), Math.cos(t) * Math.sin(around), Math.sin(t)]);
    const quiet = { type: "scatter3d", hoverinfo: "skip", showlegend: false };
    return [{ ...quiet, mode: "lines", x: path[0], y: path[1], z: path[2], opacity: 0.5, line: { color: variable("--soft"), width: 1.5 } },
      { ...quiet, mode: "text", x: [1.2, -1.2, 0, 0, 0, 0], y: [0, 0, 1.2, -1.2, 0, 0], z: [0, 0, 0, 0, 1.2, -1.2], text: ["+x", "-x", "+y", "-y", "+z", "-z"], textfont: { color: variable("--ink"), size: 13 } }];
  };
  const draw = (figure) => {
    const { data, layout: given, frames } = read(figure);
    if (given.sphere) { data.push(...globe()); delete given.sphere; }
    const options = { displaylogo: false, responsive: true, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "sendDataToCloud"] };
    Plotly.newPlot(figure, { data: coloured(data), layout: layout(given, figure.clientHeight, figure.clientWidth < 500), frames: coloured(frames || []), config: options });
    figure.dataset.drawn = "yes";
  };
  const drawOnce = (figure) => { if (!figure.dataset.drawn) draw(figure); };
  const figures = [...document.querySelectorAll("[data-plot]")];
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); drawOnce(entry.target); }
  }, { rootMargin: "300px" });
  figures.forEach((figure) => seen.observe(figure));
  dark.addEventListener("change", () => figures.filter((figure) => figure.dataset.drawn).forEach(draw));
  addEventListener("beforeprint", () => {
    document.querySelectorAll("main details:not(.data)").forEach((part) => { part.open = true; });
    document.documentElement.classList.add("printing");
    figures.forEach(dark.matches ? draw : drawOnce);
  });
  addEventListener("afterprint", () => {
    document.documentElement.classList.remove("printing");
    if (dark.matches) figures.forEach(draw);
  });
  const cell = (row, kind, text) => { row.appendChild(document.createElement(kind)).textContent = text; };
  const list = (part) => {
    if (!part.open || part.querySelector("table")) return;
    const table = part.appendChild(document.createElement("div")).appendChild(document.createElement("table"));
    table.parentElement.className = "wide";
    const { data } = read(part.closest("figure").querySelector("[data-plot]"));
    const decoded = (text) => new DOMParser().parseFromString(String(text), "text/html").documentElement.textContent;
    for (const trace of data.filter((one) => one.x && one.hoverinfo !== "skip")) {
      const head = table.insertRow();
      cell(head, "th", decoded(trace.name || ""));
      const keys = ["x", "y", "z"].filter((key) => trace[key]);
      keys.forEach((key) => cell(head, "th", key));
      trace.x.forEach((_, k) => {
        const row = table.insertRow();
        cell(row, "td", trace.text ? decoded(Array.isArray(trace.text) ? trace.text[k] : trace.text) : "");
        keys.forEach((key) => { const v = trace[key][k]; cell(row, "td", typeof v === "number" ? String(Number(v.toPrecision(5))) : decoded(v)); });
      });
    }
  };
  document.querySelectorAll("details.data").forEach((part) => part.addEventListener("toggle", () => list(part)));
})();
