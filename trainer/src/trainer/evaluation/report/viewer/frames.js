// The frame that is looked at: what was chosen, what stands under the pointer.

const TRUTH = "truth";
const SIDES = ["left", "right", TRUTH];
const frameNow = () => frameAt(Number(at("frame").value));

let refreshes = 0;
let shownImages = []; // [{title, image, colour}], of the images on the screen
let shownDoppler = null;

async function refresh() {
  const frame = frameNow();
  if (!frame) return;
  const turn = ++refreshes;
  const names = { left: at("left").value, right: at("right").value, truth: frame.images[TRUTH] ? TRUTH : null };
  const images = {};
  for (const [side, name] of Object.entries(names)) images[side] = name && await levels(frame, name, frame.images[name]);
  const doppler = frame.doppler && await levels(frame, "Doppler", frame.doppler.png);
  // Pictures take time to decode: what was chosen meanwhile is drawn by its own call, and must not be overwritten.
  if (turn !== refreshes) return;
  shownImages = [];
  for (const [side, name] of Object.entries(names)) {
    const canvas = at("image-" + side);
    canvas.parentElement.style.display = name ? "" : "none";
    if (!name) continue;
    drawImage(canvas, name, images[side]);
    shownImages.push({ title: name, colour: LINES[side], image: images[side] });
  }
  shownDoppler = doppler;
  at("doppler").parentElement.style.display = doppler ? "" : "none";
  if (doppler) drawDoppler(at("doppler"), frame.doppler.title, doppler);
  at("camera").style.display = frame.camera ? "" : "none";
  if (frame.camera) at("camera-picture").src = "data:image/jpeg;base64," + frame.camera;
  drawCut(at("cut"), shownImages);
  describe();
}

function describe() {
  const row = Number(at("row").value), columns = axes.u_bins;
  at("floor-text").textContent = floorDb() + " dB";
  at("far-text").textContent = rangeOf(rowsShown()).toFixed(1) + " m";
  at("row-text").textContent = row + " (" + rangeOf(row).toFixed(2) + " m)";
  at("reading").textContent = shownImages.map((curve) => {
    let best = 0;
    for (let column = 1; column < columns; column++) {
      if (curve.image[row * columns + column] > curve.image[row * columns + best]) best = column;
    }
    const level = toDb(curve.image[row * columns + best]);
    return curve.title + ": highest " + level.toFixed(1) + " dB at u = " + uOf(best).toFixed(3);
  }).join("; ");
}

function fill(select, names) {
  select.replaceChildren(...names.map(([value, text]) => new Option(text, value)));
}

function chooseFrame() {
  const frame = frameNow();
  if (!frame) return;
  const names = Object.keys(frame.images).filter((name) => name !== TRUTH).map((name) => [name, name]);
  for (const [side, index] of [["left", 0], ["right", names.length - 1]]) {
    const before = at(side).value;
    fill(at(side), names);
    at(side).value = frame.images[before] ? before : names[index][0];
  }
  at("row").value = frame.row;
}

// The bin under the pointer; null in the margins.
function binUnder(event, place) {
  const canvas = event.currentTarget, box = canvas.getBoundingClientRect(), scale = canvas.width / box.width;
  const x = scale * (event.clientX - box.left) - MARGIN.left, y = scale * (event.clientY - box.top) - MARGIN.top;
  return x >= 0 && y >= 0 && x < place.width && y < place.height ? place.bin(x, y) : null;
}

const level = (image, columns, bin) => toDb(image[bin.row * columns + bin.column]).toFixed(1) + " dB";

function pointAt(event) {
  const place = imagePlace(), bin = binUnder(event, place);
  for (const side of SIDES) {
    const canvas = at("image-" + side), mark = canvas.nextElementSibling;
    mark.style.display = bin ? "block" : "none";
    if (!bin) continue;
    const { x, y } = place.pixel(bin.row, bin.column);
    mark.style.left = 100 * (MARGIN.left + x) / canvas.width + "%";
    mark.style.top = 100 * (MARGIN.top + y) / canvas.height + "%";
  }
  if (!bin) return void (at("pointer").textContent = "");
  const range = rangeOf(bin.row), u = uOf(bin.column);
  at("pointer").textContent = "range " + range.toFixed(2) + " m, u " + u.toFixed(3) + " (azimuth "
    + (180 / Math.PI * Math.asin(Math.max(-1, Math.min(1, u)))).toFixed(1) + "\u00b0, x "
    + (range * Math.sqrt(Math.max(0, 1 - u * u))).toFixed(2) + " m, y " + (range * u).toFixed(2) + " m): "
    + shownImages.map((one) => one.title + " " + level(one.image, axes.u_bins, bin)).join("; ");
}

function pointAtDoppler(event) {
  const bin = binUnder(event, dopplerPlace());
  at("pointer").textContent = !bin ? "" : "range " + rangeOf(bin.row).toFixed(2) + " m, velocity "
    + velocityOf(bin.column).toFixed(2) + " m/s: " + level(shownDoppler, axes.velocity_bins, bin);
}

function pickRow(place) {
  return (event) => {
    const bin = binUnder(event, place());
    if (!bin) return;
    at("row").value = bin.row;
    refresh();
  };
}

async function startLooking() {
  if (data.frames.length === 0) return void (at("look").style.display = "none");
  at("row").max = axes.range_bins - 1;
  at("far").max = axes.range_bins;
  at("far").value = axes.range_bins;
  at("scale").style.background = "linear-gradient(to right, " + data.colours.map((rgb) => "rgb(" + rgb + ")") + ")";
  fill(at("frame"), data.frames.map((frame, index) => [String(index), frame.name]));
  chooseFrame();
  at("frame").addEventListener("change", () => { chooseFrame(); refresh(); });
  for (const id of ["left", "right", "view"]) at(id).addEventListener("change", refresh);
  for (const id of ["floor", "row", "far"]) at(id).addEventListener("input", refresh);
  for (const side of SIDES) {
    at("image-" + side).addEventListener("click", pickRow(imagePlace));
    for (const kind of ["pointermove", "pointerleave"]) at("image-" + side).addEventListener(kind, pointAt);
  }
  at("doppler").addEventListener("click", pickRow(dopplerPlace));
  for (const kind of ["pointermove", "pointerleave"]) at("doppler").addEventListener(kind, pointAtDoppler);
  await refresh();
}
