// What the page holds: every image is an 8-bit PNG of levels, 0 for the floor, 255 for 0 dB.

const at = (id) => document.getElementById(id);
const data = JSON.parse(at("data").textContent);
const axes = data.axes;

const toDb = (level) => data.span_db * (level / 255 - 1);
const uOf = (column) => axes.u_start + axes.u_step * column;
const rangeOf = (row) => axes.range_step_m * row;
const velocityOf = (column) => axes.velocity_start + axes.velocity_step * column;
const floorDb = () => Number(at("floor").value);
const rowsShown = () => Number(at("far").value);

function colour(db) {
  const place = Math.max(0, Math.min(255, Math.round(255 * (1 - db / floorDb()))));
  return data.colours[place];
}

// A frame's pictures are parsed when it is chosen: of fifty frames one is looked at first.
const parsed = new Map();

function frameAt(index) {
  if (!data.frames[index]) return null;
  if (!parsed.has(index)) parsed.set(index, { ...data.frames[index], ...JSON.parse(at("frame-" + index).textContent) });
  return parsed.get(index);
}

const decoded = new WeakMap(); // frame -> Map of name -> Uint8Array [range, column]

async function levels(frame, name, png) {
  if (!decoded.has(frame)) decoded.set(frame, new Map());
  const images = decoded.get(frame);
  if (!images.has(name)) {
    const picture = new Image();
    picture.src = "data:image/png;base64," + png;
    await picture.decode();
    const canvas = document.createElement("canvas");
    canvas.width = picture.naturalWidth;
    canvas.height = picture.naturalHeight;
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height).data;
    images.set(name, Uint8Array.from({ length: pixels.length / 4 }, (_, index) => pixels[4 * index]));
  }
  return images.get(name);
}
