// The table of numbers, and the start.

const MOST_ROWS = 2000;
const FILTERS = ["experiment", "method", "array", "metric"];
const shown = (value) => value === null ? "" : typeof value === "string" ? value
  : Number.isInteger(value) ? String(value) : Math.abs(value) >= 1e4 || Math.abs(value) < 1e-3 && value !== 0
  ? value.toExponential(2) : value.toPrecision(4);

function numbers() {
  const columns = data.table.columns;
  const chosen = data.table.rows.filter((row) => FILTERS.every((name) => {
    const wanted = at("filter-" + name).value;
    return wanted === "" || row[columns.indexOf(name)] === wanted;
  }));
  at("body").replaceChildren(...chosen.slice(0, MOST_ROWS).map((row) => {
    const line = document.createElement("tr");
    for (const value of row) {
      const cell = document.createElement("td");
      cell.textContent = shown(value);
      if (typeof value !== "string") cell.className = "number";
      line.append(cell);
    }
    return line;
  }));
  const count = chosen.length === 1 ? "1 row" : chosen.length + " rows";
  at("count").textContent = chosen.length > MOST_ROWS ? "the first " + MOST_ROWS + " of " + count + "; choose further" : count;
}

function startNumbers() {
  at("head").replaceChildren(...data.table.columns.map((name) => {
    const cell = document.createElement("th");
    cell.textContent = name.replaceAll("_", " ");
    return cell;
  }));
  for (const name of FILTERS) {
    const column = data.table.columns.indexOf(name);
    const values = [...new Set(data.table.rows.map((row) => row[column]))];
    fill(at("filter-" + name), [["", "all"], ...values.map((value) => [value, value])]);
    at("filter-" + name).addEventListener("change", numbers);
  }
  numbers();
}

async function start() {
  startNumbers();
  await startLooking();
  document.body.dataset.ready = "yes";
}

start();
