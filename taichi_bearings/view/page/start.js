async function unpacked(id) {
  const text = atob(element(id).textContent.trim()), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  element(id).remove();
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

async function start() {
  const began = performance.now();
  if (!("DecompressionStream" in window)) throw new Error("this browser is too old: it must know DecompressionStream, as all do since 2023");
  const code = await (await unpacked("library")).text();
  document.head.append(Object.assign(document.createElement("script"), { textContent: code }));
  const facts = JSON.parse(element("facts").textContent), bytes = await (await unpacked("arrays")).arrayBuffer(), arrays = {};
  const kinds = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };
  for (const { name, kind, offset, length } of facts.arrays) arrays[name] = new kinds[kind](bytes, offset, length);
  const sample = new Sample(facts, arrays);
  if (sample.dimension === 2) LOOK.cut = "#1d2733";  // lines on coloured discs
  const choices = { layers: {}, power: 0, threshold: 0, time: facts.times.length, low: sample.slices.map(() => 0), high: sample.slices.map(({ steps }) => steps) };
  let picture;
  try {
    picture = new Picture(sample, choices, element("canvas"));
  } catch (error) {
    throw new Error(`this browser shows nothing in three dimensions (WebGL 2): ${error.message}`);
  }
  const controls = new Controls(sample, choices, picture);
  listenToCanvas(sample, picture);
  element("message").textContent = "";
  window.bearings = { sample, choices, picture, controls, frameTime: (frames) => frameTime(picture, frames), milliseconds: performance.now() - began };
}

window.addEventListener("DOMContentLoaded", () => start().catch((error) => { element("message").textContent = `Nothing can be shown: ${error.message}.`; console.error(error); }));
