
const table = document.querySelector("table");
const rows = [...table.tBodies[0].rows];
const number = (cell) => {
  const found = cell.textContent.match(/\d+(\.\d+)?/);
  return found ? Number(found[0]) : NaN;
};
let sorted = null;
let upwards = true;

function sortBy(column) {
  upwards = sorted === column ? !upwards : true;
  sorted = column;
  const compare = (a, b) => {
    const [x, y] = [a.cells[column], b.cells[column]];
    if (column === 0) return x.textContent.localeCompare(y.textContent);
    const [m, n] = [number(x), number(y)];
    if (Number.isNaN(m) || Number.isNaN(n)) return Number.isNaN(m) - Number.isNaN(n);
    return m - n;
  };
  const missing = (row) => column > 0 && Number.isNaN(number(row.cells[column]));
  const known = rows.filter((row) => !missing(row)).sort(compare);
  if (!upwards) known.reverse();
  table.tBodies[0].append(...known, ...rows.filter(missing));
  [...table.tHead.rows[0].cells].forEach((head, k) => {
    head.setAttribute("aria-sort", k !== column ? "none" : upwards ? "ascending" : "descending");
  });
}

function filter() {
  const text = document.querySelector("#text").value.toLowerCase();
  const size = document.querySelector("#size").value;
  for (const row of rows) {
    const fits = row.textContent.toLowerCase().includes(text);
    row.hidden = !fits || (size !== "" && row.dataset.size !== size);
  }
}

table.tHead.querySelectorAll("button").forEach((button, k) => button.addEventListener("click", () => sortBy(k)));
document.querySelector("#text").addEventListener("input", filter);
document.querySelector("#size").addEventListener("change", filter);
