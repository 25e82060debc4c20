// From bins to pixels and back. A place has: columns, the size of its picture [pixels], bin(x, y) -> {row, column} or
// null, and pixel(row, column) -> {x, y}, of the bin's middle; pixels count from the picture's upper left corner.

// Range upwards, columns to the right, or to the left where mirrored: u rises to the left, as one sees it from the radar.
function straight(columns, mirrored, width, height) {
  const rows = rowsShown();
  const turned = (column) => mirrored ? columns - 1 - column : column;
  return {
    columns, width, height,
    bin: (x, y) => ({ row: Math.min(rows - 1, Math.floor((1 - y / height) * rows)), column: turned(Math.floor(x / width * columns)) }),
    pixel: (row, column) => ({ x: (turned(column) + 0.5) * width / columns, y: height * (1 - (row + 0.5) / rows) }),
  };
}

// From above: x = r sqrt(1 - u^2) upwards, y = r u to the left, as if all echoes came from the radar's own height.
function above(width, height) {
  const far = rangeOf(rowsShown()), columns = axes.u_bins;
  const inside = (u) => Math.max(-1, Math.min(1, u));
  const left = inside(uOf(columns)), right = inside(uOf(0));
  const aside = far * (Math.max(left, 0) - Math.min(right, 0));
  const scale = Math.min(width / aside, height / far);
  const sensor = far * Math.max(left, 0) * scale; // its pixel from the left
  return {
    columns, width: Math.round(aside * scale), height: Math.round(far * scale), metres: 1 / scale, sensor,
    bin: (x, y) => {
      const ahead = far - y / scale, toLeft = (sensor - x) / scale, range = Math.hypot(ahead, toLeft);
      const row = Math.round(range / axes.range_step_m);
      const column = Math.round((toLeft / Math.max(range, 1e-9) - axes.u_start) / axes.u_step);
      return ahead >= 0 && row < rowsShown() && column >= 0 && column < columns ? { row, column } : null;
    },
    pixel: (row, column) => {
      const u = inside(uOf(column)), range = rangeOf(row);
      return { x: sensor - range * u * scale, y: (far - range * Math.sqrt(1 - u * u)) * scale };
    },
  };
}

// The highest level of the bins that fall on each pixel (peak hold): a target may be one bin, and bins may outnumber
// pixels. A pixel that no bin falls on shows the bin it lies in; -1 where there is none.
function peakHold(image, place) {
  const { columns, width, height } = place;
  const held = new Int16Array(width * height).fill(-1);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const bin = place.bin(x + 0.5, y + 0.5);
      if (bin) held[y * width + x] = image[bin.row * columns + bin.column];
    }
  }
  for (let row = 0; row < rowsShown(); row++) {
    for (let column = 0; column < columns; column++) {
      const { x, y } = place.pixel(row, column);
      const line = Math.min(Math.floor(y), height - 1), across = Math.max(0, Math.min(Math.floor(x), width - 1));
      const pixel = line * width + across;
      held[pixel] = Math.max(held[pixel], image[row * columns + column]);
    }
  }
  return held;
}
