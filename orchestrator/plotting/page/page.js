"use strict";
/* Tables that sort, and a mark that scripts run. */
(() => {
  document.documentElement.classList.add("scripted");

  function compared(a, b) {
    if (a === b) return 0;
    if (a === null) return 1;
    if (b === null) return -1;
    return typeof a === "number" && typeof b === "number" ? a - b
      : String(a).localeCompare(String(b), undefined, { numeric: true });
  }

  function valueOf(row, column) {
    const cell = row.cells[column];
    if (!cell) return null;
    const text = cell.textContent.trim();
    if (cell.dataset.value !== undefined) return Number(cell.dataset.value);
    return text === "" || text === "-" ? null : text;
  }

  for (const table of document.querySelectorAll("table.sorts")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((one) => one.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const rows = [...table.tBodies[0].rows];
        rows.sort((a, b) => {
          const [x, y] = [valueOf(a, column), valueOf(b, column)];
          /* Empty cells stay last, whichever way. */
          return (x === null) !== (y === null) || !down ? compared(x, y) : -compared(x, y);
        });
        table.tBodies[0].append(...rows);
      });
    });
  }
})();
