// Starts the 3D view of a page and its buttons, or shows why it cannot start.
(async () => {
  const box = document.querySelector(".scene-view");
  const place = box.querySelector(".canvas");
  const show = (text) => {
    const line = document.createElement("p");
    line.textContent = text;
    place.replaceChildren(line);
  };
  if (!document.createElement("canvas").getContext("webgl2")) {
    show("The 3D view requires WebGL 2, which this browser does not support.");
    return;
  }
  show("Loading the scene …");
  const decoded = (id) => {
    const text = document.getElementById(id)?.textContent ?? globalThis[id];
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  };
  const [frame, buttons] = [box.querySelector(".frame"), box.querySelector(".buttons")];
  const [back, play, whole] = buttons.querySelectorAll("button");
  const choice = buttons.querySelector("select");
  try {
    if (!globalThis.showScene) {
      const packed = new Blob([decoded("viewer-data")]).stream();
      const script = document.createElement("script");
      const plain = packed.pipeThrough(new DecompressionStream("gzip"));
      script.textContent = await new Response(plain).text();
      document.head.append(script);
    }
    const setup = JSON.parse(document.getElementById("scene-setup").textContent);
    let shown;
    const label = () => {
      play.textContent = shown?.sweeping === false ? "Play" : "Pause";
      back.hidden = !shown?.away;
      if (shown?.away || shown?.sweeping) choice.value = "";
    };
    shown = await showScene(place, decoded("scene-data"), setup, label);
    choice.onchange = () => choice.value && shown.look(Number(choice.value));
    back.onclick = shown.back;
    play.onclick = () => (shown.sweeping ? shown.pause() : shown.play());
    whole.hidden = !document.fullscreenEnabled;
    whole.onclick = () =>
      document.fullscreenElement ? document.exitFullscreen() : frame.requestFullscreen();
    label();
    buttons.hidden = false;
    box.shown = shown;
    box.dataset.state = "shown";
  } catch (error) {
    show(`The 3D view failed to start: ${error.message}`);
    box.dataset.state = "failed";
  }
})();
