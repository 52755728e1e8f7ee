/** The token that a service may want: asked for in a form, kept for this tab only, sent in a header only. */

import { say } from "./dom.js";

const KEY = "fuselog-token";

/** The form and the button that forgets; `changed` is called when there is another token, or none any more. */
export class Token {
  #value = stored();

  constructor({ form, input, why, forget }, changed) {
    Object.assign(this, { form, input, why, forget });
    forget.hidden = this.#value === null;
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const token = input.value.trim();
      if (!/^[\x21-\x7e]+$/.test(token)) return say(why, "A token has letters, digits and signs only.");
      this.#keep(token);
      input.value = "";
      form.hidden = true;
      changed();
    });
    forget.addEventListener("click", () => {
      this.#keep(null);
      changed();
    });
  }

  /** The token, null when there is none. */
  get value() {
    return this.#value;
  }

  /** Show the form. */
  ask(reason) {
    const had = this.#value !== null;
    this.#keep(null);
    say(this.why, had ? `The service refused the token: ${reason}` : "This service wants a token.");
    this.form.hidden = false;
    this.input.focus();
  }

  #keep(token) {
    this.#value = token;
    this.forget.hidden = token === null;
    try {
      if (token === null) sessionStorage.removeItem(KEY);
      else sessionStorage.setItem(KEY, token);
    } catch {
      // storage is forbidden here: it is known until the page is closed
    }
  }
}

function stored() {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    return null;
  }
}
