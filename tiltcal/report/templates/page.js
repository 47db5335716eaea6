"use strict";
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const read = (figure) => JSON.parse(document.getElementById(figure.dataset.plot).textContent);
  const draw = (figure) => {
    tiltcalDrawing.draw(figure, read(figure));
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
