// Sorting of the index: numbers by value, names as people sort them, what is missing last.

const names = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });

function sortBy(heads, column) {
  const head = heads[column], down = head.getAttribute("aria-sort") === "ascending";
  for (const other of heads) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const body = byId("movies").tBodies[0], sign = down ? -1 : 1;
  const value = (row) => row.cells[column].dataset.value;
  const text = head.dataset.text !== undefined;
  const compared = (a, b) => (text ? names.compare(a, b) : Number(a) - Number(b));
  const rows = [...body.rows].sort((one, other) => {
    const [a, b] = [value(one), value(other)];
    if (a === undefined || b === undefined) return (a === undefined) - (b === undefined);
    return sign * compared(a, b);
  });
  body.append(...rows);
}

const heads = [...byId("movies").tHead.rows[0].cells];
heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => sortBy(heads, column)));
showTips();
