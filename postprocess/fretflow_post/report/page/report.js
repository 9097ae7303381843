"use strict";
(() => {
  Bokeh.logger.set_level("error");
  const style = getComputedStyle(document.documentElement);
  const shown = (curve) => document.querySelector(`input[data-curve="${curve}"]`)?.checked ?? true;

  const save = async (view, kind, name) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await view.export(kind).to_blob());
    link.download = `${name.replace(/[^\p{L}\p{N}]+/gu, "-").slice(0, 80)}.${kind}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };

  // Draws in the page's colours, which are other ones where it is dark.
  const draw = async (chart) => {
    const text = chart.querySelector("script").textContent;
    chart.replaceChildren();
    const item = JSON.parse(Object.entries(LOOKS).reduce(
      (all, [name, colour]) => all.replaceAll(colour, style.getPropertyValue(`--${name}`).trim()), text));
    const view = (await Bokeh.embed.embed_item(item, chart)).get_by_id(item.root_id);
    const buttons = document.createElement("p");
    buttons.className = "exports";
    for (const kind of ["svg", "png"]) {
      const button = buttons.appendChild(document.createElement("button"));
      button.textContent = kind.toUpperCase();
      button.addEventListener("click", () => save(view, kind, chart.getAttribute("aria-label")));
    }
    chart.append(buttons);
  };

  // What is hidden is drawn once it is shown.
  const refresh = async () => {
    const waiting = [...document.querySelectorAll(".chart:has(> script)")];
    await Promise.all(waiting.filter((chart) => chart.offsetParent !== null).map(draw));
    for (const model of Bokeh.documents.flatMap((one) => [...one.all_models])) {
      if ("muted" in model && model.name) model.visible = shown(model.name === "every sample" ? "measured" : model.name);
    }
  };

  for (const choice of document.querySelectorAll("input[name=loop]")) {
    choice.addEventListener("change", () => {
      for (const loop of document.querySelectorAll(".loop")) loop.classList.toggle("selected", loop.id === `loop-${choice.value}`);
      refresh();
    });
  }

  for (const box of document.querySelectorAll("input[data-curve]")) box.addEventListener("change", refresh);

  // A browser may keep the choices of the page before it was loaded again.
  document.querySelector("input[name=loop]:checked")?.dispatchEvent(new Event("change"));
  refresh();

  for (const button of document.querySelectorAll("button[data-unfold]")) {
    button.addEventListener("click", () => {
      document.querySelector(button.dataset.unfold).classList.add("open");
      button.setAttribute("aria-expanded", "true");
      button.parentElement.remove();
    });
  }
})();
