// Tables whose rows are kept: only what another word stands in is written again, so that 500 rows a second cost little.

import { el, inOrder, setAttribute } from "./dom.js";

/** A table that is sorted by a click on a heading.
 *
 * `columns` are {id, title, text(item)} and, where wanted, {sort(item), sign(item), hide, long}; the first holds a
 * button that chooses the row. */
export class Table {
  constructor(caption, columns, onChoose) {
    this.columns = columns;
    this.onChoose = onChoose;
    this.rows = new Map();
    this.sorting = { column: columns[0], down: false };
    this.heads = columns.map((column) => this.headOf(column));
    this.body = el("tbody");
    this.element = el(
      "table",
      { class: "things" },
      el("caption", { class: "unseen" }, caption),
      el("thead", {}, el("tr", {}, this.heads)),
      this.body,
    );
    this.showSorting();
  }

  headOf(column) {
    const button = el("button", { type: "button", onclick: () => this.sortBy(column) }, column.title);
    return el("th", { scope: "col", class: `col-${column.id}${column.hide ? " spare" : ""}` }, button);
  }

  sortBy(column) {
    this.sorting = { column, down: this.sorting.column === column && !this.sorting.down };
    this.showSorting();
    if (this.last) this.show(...this.last);
  }

  showSorting() {
    this.columns.forEach((column, index) => {
      const order = this.sorting.down ? "descending" : "ascending";
      setAttribute(this.heads[index], "aria-sort", column === this.sorting.column ? order : null);
    });
  }

  /** Shows these items; `chosen` is the id of the chosen one. */
  show(items, chosen) {
    this.last = [items, chosen];
    const sorted = [...items].sort(this.order());
    const wanted = new Set();
    let before = null;
    for (const item of sorted) {
      const key = String(item.key ?? item.id);
      wanted.add(key);
      const row = this.rows.get(key) ?? this.newRow(key);
      this.fill(row, item, key === String(chosen));
      inOrder(this.body, row.element, before);
      before = row.element;
    }
    for (const [key, row] of this.rows) {
      if (wanted.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
  }

  order() {
    const { column, down } = this.sorting;
    const value = column.sort ?? column.text;
    const sign = down ? -1 : 1;
    return (one, other) => sign * compared(value(one), value(other)) || compared(one.id, other.id);
  }

  newRow(key) {
    const row = { item: null, cells: [], texts: [] };
    row.button = el("button", { type: "button", class: "pick", onclick: () => this.onChoose(row.item) });
    row.cells = this.columns.map((column, index) =>
      index === 0
        ? el("th", { scope: "row", class: `col-${column.id}` }, row.button)
        : el("td", { class: `col-${column.id}${column.hide ? " spare" : ""}` }),
    );
    row.element = el("tr", { onclick: (event) => event.target !== row.button && this.onChoose(row.item) }, row.cells);
    this.rows.set(key, row);
    return row;
  }

  fill(row, item, isChosen) {
    row.item = item;
    this.columns.forEach((column, index) => {
      const place = index === 0 ? row.button : row.cells[index];
      const text = String(column.text(item));
      if (row.texts[index] !== text) {
        row.texts[index] = text;
        place.textContent = text;
        if (column.long) setAttribute(row.cells[index], "title", text);
      }
      if (column.sign) setAttribute(row.cells[index], "data-sign", column.sign(item));
    });
    setAttribute(row.element, "class", isChosen ? "chosen" : null);
    setAttribute(row.button, "aria-pressed", isChosen ? "true" : "false");
  }
}

/** Numbers by size, words by their letters, nothing last. */
function compared(one, other) {
  const [missing, otherMissing] = [one === null || one === undefined, other === null || other === undefined];
  if (missing || otherMissing) return Number(missing) - Number(otherMissing);
  if (typeof one === "number" && typeof other === "number") return one - other;
  return String(one).localeCompare(String(other), "en", { numeric: true });
}
