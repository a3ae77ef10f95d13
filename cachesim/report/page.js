"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const runOf = new Map(data.runs.map((run) => [`${run.path}\n${run.run}`, run]));
  const label = (row) => ({ ...row, label: runOf.get(`${row.path}\n${row.run}`).label });
  const rows = { distances: data.distances, curve: data.curve };
  for (const [name, found] of Object.entries(data.results)) rows[name] = found.map(label);
  (rows.replay || []).forEach((row, i) => { row.case = data.cases[i]; });
  const form = document.querySelector(".switch");
  const isShown = (of) => ["scene", "tree"].every((name) => !form.elements[name].value || form.elements[name].value === of[name]);

  // Charts: made again, with the rows that are shown, whenever these, the width or the colours change.
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const colours = () => {
    const [front, soft, grid] = ["--front", "--soft", "--grid"].map(style);
    const text = { labelColor: front, titleColor: front };
    return {
      background: "transparent", font: "system-ui, sans-serif", view: { stroke: grid }, title: { color: front },
      axis: { ...text, gridColor: grid, domainColor: soft, tickColor: soft, titleFontWeight: 500 },
      legend: { ...text, orient: "bottom", columns: 4, labelLimit: 240, titleFontWeight: 500, symbolBaseStrokeColor: front },
      header: text, rule: { color: soft }, mark: { color: front },
    };
  };
  // Okabe and Ito's black is not seen on black.
  const onDark = (spec) => (dark.matches ? JSON.parse(JSON.stringify(spec).replaceAll('"#000000"', '"#f0f0f0"')) : spec);

  async function draw(place) {
    const { spec, rows: name, columns, lines } = data.charts[place.dataset.chart];
    const values = rows[name].filter(isShown);
    const width = place.parentElement.clientWidth;
    if (!width || !values.length) {
      place.replaceChildren();
      return;
    }
    const made = JSON.parse(JSON.stringify(onDark(spec)));
    const inner = made.spec || made;
    const wide = columns > 1 && width > 700 ? columns : 1;
    if (made.facet) made.columns = wide;
    if (made.facet) inner.width = Math.max(160, Math.floor((width - 70 - 20 * (wide - 1)) / wide));
    else Object.assign(made, { width, autosize: { type: "fit-x", contains: "padding" } });
    if (lines) made.height = Math.max(1, new Set(values.map((row) => row[lines])).size) * made.height.step;
    const config = colours();
    config.legend.columns = Math.max(1, Math.min(4, Math.floor(width / 220)));
    await vegaEmbed(place, { ...made, data: { values }, config }, { actions: false, renderer: "svg", tooltip: { theme: dark.matches ? "dark" : "light" } });
  }
  const places = [...document.querySelectorAll("[data-chart]")];
  let drawing = Promise.resolve();
  const drawAll = () => {
    drawing = drawing.then(async () => {
      for (const place of places) await draw(place);
      document.documentElement.dataset.drawn = `${form.elements.scene.value}/${form.elements.tree.value}`;
    });
    return drawing;
  };

  // The switch.
  function show() {
    let n = 0;
    for (const each of document.querySelectorAll("[data-scene]")) {
      each.hidden = !isShown(each.dataset);
      n += each.matches("article") && !each.hidden;
    }
    document.querySelector(".nothing").hidden = n > 0;
    drawAll();
  }
  form.addEventListener("change", show);
  form.addEventListener("submit", (event) => event.preventDefault());

  // Tables: numbers largest first, then smallest; texts the other way round; what has no number comes last.
  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.firstElementChild.addEventListener("click", () => {
        const body = table.tBodies[0];
        const lines = [...body.rows];
        const keys = new Map(lines.map((line) => [line, line.cells[column].dataset.order]));
        const isText = head.classList.contains("left");
        const first = isText ? "ascending" : "descending";
        const other = isText ? "descending" : "ascending";
        const order = head.getAttribute("aria-sort") === first ? other : first;
        const sign = order === "ascending" ? 1 : -1;
        lines.sort((a, b) => {
          const [x, y] = [keys.get(a), keys.get(b)];
          if (x === "" || y === "") return (x === "") - (y === "");
          return sign * (isText ? x.localeCompare(y) : x - y);
        });
        heads.forEach((each) => each.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", order);
        body.append(...lines);
      });
    });
  }

  // Heat maps.
  const viridis = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
  const palette = new Uint8ClampedArray(256 * 4);
  const context = Object.assign(document.createElement("canvas"), { width: 256, height: 1 }).getContext("2d", { willReadFrequently: true });
  const gradient = context.createLinearGradient(0, 0, 256, 0);
  viridis.forEach((colour, i) => gradient.addColorStop(i / (viridis.length - 1), colour));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 1);
  palette.set(context.getImageData(0, 0, 256, 1).data);
  for (const bar of document.querySelectorAll(".bar")) bar.getContext("2d").putImageData(new ImageData(palette.slice(), 256, 1), 0, 0);

  async function numbersOf(text) {
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const view = new DataView(await new Response(stream).arrayBuffer());
    return Uint32Array.from({ length: view.byteLength / 4 }, (_, i) => view.getUint32(4 * i, true));
  }
  const output = document.querySelector(".value");
  async function paint(canvas) {
    const { kind, maps, most } = data.heat[canvas.dataset.kind];
    const { width, height, side, data: packed } = maps[canvas.dataset.run];
    const values = await numbersOf(packed);
    Object.assign(canvas, { width, height });
    const image = new ImageData(width, height);
    values.forEach((value, i) => {
      const colour = 4 * Math.round(255 * Math.min(1, value / (most * side * side)));
      image.data.set(palette.subarray(colour, colour + 4), 4 * i);
    });
    canvas.getContext("2d").putImageData(image, 0, 0);
    canvas.dataset.total = values.reduce((sum, value) => sum + value, 0);
    let [x, y] = [width >> 1, height >> 1];
    const say = (left, top) => {
      const at = side === 1 ? `pixel ${x}, ${y}` : `${side} x ${side} pixels at ${x * side}, ${y * side}`;
      output.textContent = `${at}: ${values[y * width + x].toLocaleString("en")} ${kind}`;
      output.hidden = false;
      output.style.left = `${Math.min(left + 14, innerWidth - output.offsetWidth - 8)}px`;
      output.style.top = `${top + 14}px`;
    };
    const atCell = () => {
      const box = canvas.getBoundingClientRect();
      say(box.left + ((x + 0.5) * box.width) / width, box.top + ((y + 0.5) * box.height) / height);
    };
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      x = Math.max(0, Math.min(width - 1, Math.floor(((event.clientX - box.left) / box.width) * width)));
      y = Math.max(0, Math.min(height - 1, Math.floor(((event.clientY - box.top) / box.height) * height)));
      say(event.clientX, event.clientY);
    });
    for (const leaving of ["pointerleave", "blur"]) canvas.addEventListener(leaving, () => { output.hidden = true; });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!step) return;
      event.preventDefault();
      x = Math.max(0, Math.min(width - 1, x + step[0]));
      y = Math.max(0, Math.min(height - 1, y + step[1]));
      atCell();
    });
  }

  let timer;
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === width) return;
    width = innerWidth;
    clearTimeout(timer);
    timer = setTimeout(drawAll, 150);
  });
  dark.addEventListener("change", drawAll);
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((each) => { each.open = true; }));
  Promise.all([...document.querySelectorAll(".heat")].map(paint)).then(() => { document.documentElement.dataset.painted = "yes"; });
  show();
})();
