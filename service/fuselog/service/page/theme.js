/** Light, dark, or as the system has it; remembered in this browser. */

import { say } from "./dom.js";

const NEXT = { system: "light", light: "dark", dark: "system" };
const KEY = "fuselog-theme";

/** Let a button change it. */
export function themeButton(button) {
  const show = (theme) => {
    document.documentElement.classList.remove("light", "dark");
    if (theme !== "system") document.documentElement.classList.add(theme);
    say(button, `Colours: ${theme}`);
  };
  let theme = remembered();
  button.addEventListener("click", () => {
    theme = NEXT[theme];
    remember(theme);
    show(theme);
  });
  show(theme);
}

function remembered() {
  try {
    const theme = localStorage.getItem(KEY);
    return Object.hasOwn(NEXT, theme) ? theme : "system";
  } catch {
    return "system"; // storage is forbidden here
  }
}

function remember(theme) {
  try {
    localStorage.setItem(KEY, theme);
  } catch {
    // until the page is closed, then
  }
}
