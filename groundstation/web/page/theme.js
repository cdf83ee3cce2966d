// Dark, light or high contrast: as the system says until somebody chooses, kept for the next time.

const KEY = "theme";

function wanted(choice) {
  if (choice !== "system") return choice;
  if (matchMedia("(prefers-contrast: more)").matches) return "contrast";
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

/** Follows a select and the system; `onChange` is called after each change of colours. */
export function followTheme(select, onChange) {
  const apply = () => {
    document.documentElement.dataset.theme = wanted(select.value);
    onChange();
  };
  select.value = localStorage.getItem(KEY) ?? "system";
  if (!select.value) select.value = "system";
  select.addEventListener("change", () => {
    localStorage.setItem(KEY, select.value);
    apply();
  });
  for (const query of ["(prefers-contrast: more)", "(prefers-color-scheme: dark)"]) {
    matchMedia(query).addEventListener("change", apply);
  }
  apply();
}
