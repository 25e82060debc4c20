// Images, the cut and the range-Doppler map.

const MARGIN = { left: 46, right: 8, top: 22, bottom: 34 };
const LINES = { left: "#0072b2", right: "#d55e00", truth: "#000000" };
const EMPTY = [225, 225, 225];
const SIZE = { width: 400, height: 460 };
const PICTURE = { width: SIZE.width - MARGIN.left - MARGIN.right, height: SIZE.height - MARGIN.top - MARGIN.bottom };

const imagePlace = () => at("view").value === "above" ? above(PICTURE.width, PICTURE.height)
  : straight(axes.u_bins, true, PICTURE.width, PICTURE.height);
const dopplerPlace = () => straight(axes.velocity_bins, false, PICTURE.width, PICTURE.height);

function ticks(first, last, step, place, draw) {
  // Counted, not added up: a sum of steps misses zero, and reads "-0.0".
  for (let count = Math.ceil(first / step - 1e-9); count * step <= last + 1e-9; count++) draw(count * step, place(count * step));
}

// 1, 2 or 5 times a power of ten: at most so many ticks.
function tickStep(span, most) {
  const power = 10 ** Math.floor(Math.log10(span / most));
  return [1, 2, 5, 10].map((times) => times * power).find((step) => span / step <= most);
}

const digits = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));

// The held levels into the canvas, its margins free for the axes.
function drawLevels(canvas, title, image, place) {
  canvas.width = place.width + MARGIN.left + MARGIN.right;
  canvas.height = place.height + MARGIN.top + MARGIN.bottom;
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(place.width, place.height);
  peakHold(image, place).forEach((level, index) => {
    pixels.data.set([...(level < 0 ? EMPTY : colour(toDb(level))), 255], 4 * index);
  });
  context.putImageData(pixels, MARGIN.left, MARGIN.top);
  context.fillStyle = "#222";
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillText(title, MARGIN.left, 14);
  return context;
}

// Ticks and names of the axes: left upwards from 0, below from first to last.
function drawAxes(context, place, up, across) {
  const { width, height } = place;
  context.textAlign = "right";
  const upStep = tickStep(up.last, 7);
  ticks(0, up.last, upStep, (value) => MARGIN.top + height * (1 - value / up.last),
    (value, y) => context.fillText(value.toFixed(digits(upStep)), MARGIN.left - 5, y + 4));
  context.textAlign = "center";
  const low = Math.min(across.first, across.last), high = Math.max(across.first, across.last);
  const step = tickStep(high - low, 7);
  ticks(low, high, step,
    (value) => MARGIN.left + width * (value - across.first) / (across.last - across.first),
    (value, x) => context.fillText(value.toFixed(digits(step)), x, MARGIN.top + height + 16));
  context.fillText(across.name, MARGIN.left + width / 2, MARGIN.top + height + 30);
  context.save();
  context.translate(12, MARGIN.top + height / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(up.name, 0, 0);
  context.restore();
}

// The cut's range bin is pointed at from both sides: a line across would cover it.
function pointAtCut(context, place) {
  const row = Number(at("row").value);
  if (row >= rowsShown()) return;
  const y = MARGIN.top + place.pixel(row, 0).y;
  context.fillStyle = "#d00";
  for (const [edge, out] of [[MARGIN.left, -6], [MARGIN.left + place.width, 6]]) {
    context.beginPath();
    context.moveTo(edge, y);
    context.lineTo(edge + out, y - 5);
    context.lineTo(edge + out, y + 5);
    context.fill();
  }
}

function drawImage(canvas, title, image) {
  const place = imagePlace(), context = drawLevels(canvas, title, image, place), far = rangeOf(rowsShown());
  if (at("view").value === "above") {
    const left = place.sensor * place.metres;
    drawAxes(context, place, { last: far, name: "x, ahead [m]" },
      { first: left, last: left - place.width * place.metres, name: "y, to the left [m]" });
    // The arc of the cut.
    const range = rangeOf(Number(at("row").value)) / place.metres;
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, MARGIN.top, place.width, place.height);
    context.clip();
    context.strokeStyle = "#d00";
    context.setLineDash([2, 6]);
    context.beginPath();
    context.arc(MARGIN.left + place.sensor, MARGIN.top + place.height, range, Math.PI, 2 * Math.PI);
    context.stroke();
    context.restore();
  } else {
    drawAxes(context, place, { last: far, name: "range [m]" },
      { first: uOf(axes.u_bins), last: axes.u_start, name: "u = sin(azimuth)" });
    pointAtCut(context, place);
  }
}

function drawDoppler(canvas, title, image) {
  const place = dopplerPlace(), context = drawLevels(canvas, title, image, place);
  drawAxes(context, place, { last: rangeOf(rowsShown()), name: "range [m]" },
    { first: velocityOf(0), last: velocityOf(axes.velocity_bins), name: "velocity [m/s], receding" });
  pointAtCut(context, place);
}

function drawCut(canvas, curves) {
  const context = canvas.getContext("2d");
  const columns = axes.u_bins, row = Number(at("row").value);
  const width = canvas.width - MARGIN.left - MARGIN.right, height = canvas.height - MARGIN.top - MARGIN.bottom;
  const uStop = uOf(columns), span = uStop - axes.u_start;
  const x = (u) => MARGIN.left + width * (uStop - u) / span;
  const y = (db) => MARGIN.top + height * Math.min(1, db / floorDb());
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = "#222";
  context.strokeStyle = "#ddd";
  context.textAlign = "right";
  ticks(floorDb(), 0, 10, y, (value, place) => {
    context.fillText(value.toFixed(0) + " dB", MARGIN.left - 4, place + 4);
    context.strokeRect(MARGIN.left, place, width, 0);
  });
  context.textAlign = "center";
  ticks(axes.u_start, uStop, 0.2, x, (value, place) => context.fillText(value.toFixed(1), place, canvas.height - 18));
  context.fillText("u = sin(azimuth)", MARGIN.left + width / 2, canvas.height - 4);
  let place = MARGIN.left;
  for (const curve of curves) {
    context.strokeStyle = context.fillStyle = curve.colour;
    context.lineWidth = 1.4;
    context.beginPath();
    for (let column = 0; column < columns; column++) {
      context.lineTo(x(uOf(column)), y(toDb(curve.image[row * columns + column])));
    }
    context.stroke();
    context.textAlign = "left";
    context.fillText("— " + curve.title, place, 14);
    place += context.measureText("— " + curve.title).width + 24;
  }
}
