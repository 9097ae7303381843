"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const numbers = (text) => text.split(" ").map(Number);

  const element = (name, attributes, parent) => {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return parent.appendChild(made);
  };

  // An axis turns pixels into the value that is shown.
  const axis = (chart, letter) => {
    const [low, high, start, end] = numbers(chart.dataset[letter]);
    const unit = chart.dataset[`${letter}Unit`];
    const value = (pixel) => low + ((pixel - start) / (end - start)) * (high - low);
    const step = Math.abs((high - low) / (end - start));
    const digits = Math.min(12, Math.max(0, Math.ceil(-Math.log10(step))));
    const text = (pixel) => `${value(pixel).toFixed(digits).replace("-", "−")}${unit ? ` ${unit}` : ""}`;
    return { text };
  };

  // Missing points are kept, outside the picture, so that the curves count alike.
  const points = (path) => [...path.getAttribute("d").matchAll(/[ML](-?[\d.]+)[ ]?(-?[\d.]+)/g)].map((m) => {
    const at = [Number(m[1]), Number(m[2])];
    return at[0] < -50 ? null : at;
  });

  const pointer = (chart, event) => {
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse());
    return [place.x, place.y];
  };

  const curves = (chart, say) => {
    const along = chart.dataset.readout === "trace";
    const axes = { x: axis(chart, "x"), y: axis(chart, "y") };
    const lines = [...chart.querySelectorAll("path.curve")].map((path) => ({
      name: path.dataset.name, points: points(path), look: path.classList[1],
    }));
    if (!lines.length) return null;
    const marks = lines.map((line) => element("circle", { r: 4, class: `at ${line.look}`, visibility: "hidden" }, chart));
    const show = (index) => {
      const parts = [];
      let place = "";
      lines.forEach((line, k) => {
        const at = line.points[index];
        if (!at) { marks[k].setAttribute("visibility", "hidden"); return; }
        marks[k].removeAttribute("visibility");
        marks[k].setAttribute("cx", at[0]);
        marks[k].setAttribute("cy", at[1]);
        if (along) place = place || `at ${axes.x.text(at[0])}: `;
        parts.push(`${line.name} ${along ? "" : `${axes.x.text(at[0])}, `}${axes.y.text(at[1])}`);
      });
      say(parts.length ? place + parts.join("; ") : "no value here");
    };
    const nearest = ([x, y]) => {
      let best = 0;
      let least = Infinity;
      lines.forEach((line) => line.points.forEach((at, k) => {
        if (!at) return;
        const distance = (at[0] - x) ** 2 + (along ? 0 : (at[1] - y) ** 2);
        if (distance < least) [best, least] = [k, distance];
      }));
      return best;
    };
    const count = Math.max(...lines.map((line) => line.points.length));
    let current = 0;
    return {
      at: (place) => show(current = nearest(place)),
      step: (across) => show(current = (current + across + count) % count),
    };
  };

  const map = (chart, say) => {
    const data = chart.dataset;
    const [left, top, width, height] = numbers(data.box);
    const columns = Number(data.columns);
    const step = Number(data.step);
    const values = data.values.split(",");
    const rows = values.length / columns;
    const names = data.names ? data.names.split("\n") : null;
    const axes = { x: axis(chart, "x"), y: axis(chart, "y") };
    const digits = Math.max(0, Math.ceil(-Math.log10(step)));
    const mark = element("rect", { class: "at cell", width: width / columns, height: height / rows, visibility: "hidden" }, chart);
    let row = 0;
    let column = 0;
    const show = () => {
      const [x, y] = [left + ((column + 0.5) / columns) * width, top + ((row + 0.5) / rows) * height];
      mark.removeAttribute("visibility");
      mark.setAttribute("x", x - width / columns / 2);
      mark.setAttribute("y", y - height / rows / 2);
      const value = values[row * columns + column];
      const text = value === "" ? "no value" : `${(Number(value) * step).toFixed(digits).replace("-", "−")} ${data.unit}`;
      const where = names ? `${names[row]}, at ${axes.x.text(x)} of the period` : `x ${axes.x.text(x)}, y ${axes.y.text(y)}`;
      say(`${where}: ${text}`);
    };
    const within = (value, count) => Math.min(count - 1, Math.max(0, Math.floor(value * count)));
    return {
      at: ([x, y]) => { column = within((x - left) / width, columns); row = within((y - top) / height, rows); show(); },
      step: (across, down) => { column = (column + across + columns) % columns; row = (row + down + rows) % rows; show(); },
    };
  };

  const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  for (const chart of document.querySelectorAll("svg[data-readout]")) {
    const line = chart.parentElement.querySelector(".readout");
    const reader = (chart.dataset.readout === "map" ? map : curves)(chart, (text) => { line.textContent = text; });
    if (!reader) continue;
    chart.addEventListener("pointermove", (event) => reader.at(pointer(chart, event)));
    chart.addEventListener("pointerdown", (event) => reader.at(pointer(chart, event)));
    chart.addEventListener("keydown", (event) => {
      const move = KEYS[event.key];
      if (!move || (move[1] && chart.dataset.readout !== "map")) return;
      event.preventDefault();
      const far = event.shiftKey ? 10 : 1;
      reader.step(move[0] * far, move[1]);
    });
  }

  for (const choice of document.querySelectorAll("input[name=loop]")) {
    choice.addEventListener("change", () => {
      for (const loop of document.querySelectorAll(".loop")) loop.classList.toggle("selected", loop.id === `loop-${choice.value}`);
    });
  }

  for (const box of document.querySelectorAll("input[data-curve]")) {
    box.addEventListener("change", () => document.getElementById("loops").classList.toggle(`hide-${box.dataset.curve}`, !box.checked));
  }

  // A browser may keep the choices of the page before it was loaded again.
  for (const input of document.querySelectorAll("#loops input")) {
    if (input.type === "checkbox" || input.checked) input.dispatchEvent(new Event("change"));
  }

  for (const button of document.querySelectorAll("button[data-unfold]")) {
    button.addEventListener("click", () => {
      document.querySelector(button.dataset.unfold).classList.add("open");
      button.setAttribute("aria-expanded", "true");
      button.parentElement.remove();
    });
  }
})();
