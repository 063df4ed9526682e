// Tables that change while one reads them: rows stay where they are as long as they are about the same thing, so that focus and
// selection do too. And numbers as people read them.

// Makes the rows of a table those of `items`; `cells` gives texts, or nodes that are kept from one time to the next.
export function fill(table, items, key, cells, row = () => {}) {
  const body = table.tBodies[0], known = new Map([...body.rows].map((line) => [line.dataset.key, line]));
  items.forEach((item, place) => {
    const id = String(key(item));
    let line = known.get(id);
    known.delete(id);
    if (!line) {
      line = document.createElement("tr");
      line.dataset.key = id;
    }
    if (body.rows[place] !== line) body.insertBefore(line, body.rows[place] ?? null);
    cells(item, line).forEach((cell, column) => put(line, column, cell));
    row(line, item);
  });
  known.forEach((line) => line.remove());
}

function put(line, column, cell) {
  const td = line.cells[column] ?? line.insertCell();
  if (cell instanceof Node) {
    if (td.firstChild !== cell) td.replaceChildren(cell);
    return;
  }
  const [text, look] = Array.isArray(cell) ? cell : [cell, ""];
  if (td.textContent !== text) td.textContent = text;
  if (td.className !== look) td.className = look;
}

export function set(id, text) {
  const node = document.getElementById(id);
  if (node.textContent !== text) node.textContent = text;
}

export function percent(x, digits = 3) {
  return `${Number((100 * x).toPrecision(digits)).toString()} %`;
}

export function count(x) {
  for (const [unit, size] of [["T", 1e12], ["G", 1e9], ["M", 1e6], ["k", 1e3]]) {
    if (x >= size) return `${(x / size).toPrecision(3)} ${unit}`;
  }
  return String(Math.round(x));
}

export function duration(s) {
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 100) return `${Math.round(s)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`;
  if (s < 172800) return `${Math.floor(s / 3600)} h ${Math.round(s % 3600 / 60)} min`;
  return `${(s / 86400).toFixed(1)} days`;
}

export function clock(s) {
  const then = new Date(1000 * s), time = then.toLocaleTimeString("en-GB");
  return then.toDateString() === new Date().toDateString() ? time : `${then.toLocaleDateString("en-CA")} ${time}`;
}

// A value with its error: as many digits as the error leaves sense in.
export function measured(value, error) {
  if (!Number.isFinite(error)) return `${value.toPrecision(4)} ± ?`;
  const digits = error > 0 ? Math.max(0, Math.min(9, 1 - Math.floor(Math.log10(error)))) : 6;
  return `${value.toFixed(digits)} ± ${error.toFixed(digits)}`;
}
