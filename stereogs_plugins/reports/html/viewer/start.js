// Starts the 3D view of a report, or says why there is none.
(async () => {
  const box = document.querySelector(".scene-view");
  const place = box.querySelector(".canvas");
  const say = (text) => {
    place.textContent = text;
  };
  if (!document.createElement("canvas").getContext("webgl2")) {
    say("The 3D view needs WebGL 2, which this browser does not offer.");
    return;
  }
  const held = (id) => {
    const text = document.getElementById(id)?.textContent ?? globalThis[id];
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  };
  try {
    if (!globalThis.showScene) {
      const packed = new Blob([held("viewer-data")]).stream();
      const script = document.createElement("script");
      const plain = packed.pipeThrough(new DecompressionStream("gzip"));
      script.textContent = await new Response(plain).text();
      document.head.append(script);
    }
    const setup = JSON.parse(document.getElementById("scene-setup").textContent);
    const shown = await showScene(place, held("scene-data"), setup);
    const choice = box.querySelector("select");
    choice.addEventListener("change", () => shown.look(choice.selectedIndex));
    choice.disabled = false;
    box.dataset.state = "shown";
  } catch (error) {
    say(`The 3D view could not start: ${error.message}`);
    box.dataset.state = "failed";
  }
})();
