// Tabs as the WAI-ARIA pattern has them: one stop of the Tab key, arrows between them. The map is one of them on narrow
// screens.

import { setAttribute } from "./dom.js";

export class Tabs {
  constructor(list, onShow) {
    this.list = list;
    this.tabs = [...list.querySelectorAll("[role=tab]")];
    this.onShow = onShow;
    for (const tab of this.tabs) {
      tab.addEventListener("click", () => this.show(tab.dataset.panel));
      tab.addEventListener("keydown", (event) => this.keyed(event));
    }
  }

  /** The tabs that this width of screen has. */
  visible() {
    return this.tabs.filter((tab) => tab.offsetParent !== null);
  }

  keyed(event) {
    const tabs = this.visible();
    const at = tabs.indexOf(event.currentTarget);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (to === undefined) return;
    const tab = tabs[(to + tabs.length) % tabs.length];
    event.preventDefault();
    this.show(tab.dataset.panel);
    tab.focus();
  }

  show(name) {
    for (const tab of this.tabs) {
      const shown = tab.dataset.panel === name;
      setAttribute(tab, "aria-selected", String(shown));
      tab.tabIndex = shown ? 0 : -1;
      document.getElementById(`panel-${tab.dataset.panel}`).classList.toggle("shown", shown);
      // Not scrollIntoView: it would also move where the Tab key begins.
      if (shown) this.list.scrollLeft = tab.offsetLeft - (this.list.clientWidth - tab.offsetWidth) / 2;
    }
    this.current = name;
    this.onShow(name);
  }
}
