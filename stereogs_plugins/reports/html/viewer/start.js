// Starts the 3D view of a report, or shows why it cannot start.
(async () => {
  const box = document.querySelector(".scene-view");
  const place = box.querySelector(".canvas");
  const show = (text) => {
    place.textContent = text;
  };
  if (!document.createElement("canvas").getContext("webgl2")) {
    show("The 3D view requires WebGL 2, which this browser does not support.");
    return;
  }
  const decoded = (id) => {
    const text = document.getElementById(id)?.textContent ?? globalThis[id];
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  };
  try {
    if (!globalThis.showScene) {
      const packed = new Blob([decoded("viewer-data")]).stream();
      const script = document.createElement("script");
      const plain = packed.pipeThrough(new DecompressionStream("gzip"));
      script.textContent = await new Response(plain).text();
      document.head.append(script);
    }
    const setup = JSON.parse(document.getElementById("scene-setup").textContent);
    const shown = await showScene(place, decoded("scene-data"), setup);
    const choice = box.querySelector("select");
    choice.addEventListener("change", () => shown.look(choice.selectedIndex));
    choice.disabled = false;
    box.dataset.state = "shown";
  } catch (error) {
    show(`The 3D view failed to start: ${error.message}`);
    box.dataset.state = "failed";
  }
})();
