"use strict";
// Cells know their heads, so that a narrow page can set a table's rows below one another (style.css).
for (const table of document.querySelectorAll("table.data")) {
  const names = [], rows = table.tHead.rows;
  [...rows].forEach((row, r) => {
    let column = 0;
    for (const cell of row.cells) {
      while (names[column]?.until > r) ++column; // under a cell that spans rows
      for (const end = column + cell.colSpan; column < end; ++column)
        names[column] = {text: [names[column]?.text, cell.textContent.trim()].filter(Boolean).join(", "), until: r + cell.rowSpan};
    }
  });
  for (const body of table.tBodies)
    for (const row of body.rows)
      [...row.cells].forEach((cell, k) => { if (names[k]) cell.dataset.head = names[k].text; });
  table.classList.add("stacks");
}
