// Asks for the token when the service does. The page stays as it is behind it.

import { login, onUnauthorized } from "./api.js";
import { byId, setText } from "./dom.js";

export function installLogin() {
  let waiting = null;
  onUnauthorized(() => {
    waiting ??= ask().finally(() => {
      waiting = null;
    });
    return waiting;
  });
}

/** Resolves when the service has taken a token. */
function ask() {
  const [dialog, form, token] = ["login", "login-form", "token"].map(byId);
  setText(byId("login-answer"), "");
  dialog.showModal();
  return new Promise((resolve) => {
    // Without a token there is nothing to see behind it.
    const stay = (event) => event.preventDefault();
    const submit = async (event) => {
      event.preventDefault();
      setText(byId("login-answer"), "Asking …");
      try {
        await login(token.value);
      } catch (error) {
        return setText(byId("login-answer"), error.kind === "unauthorized" ? "Wrong token." : error.message);
      }
      form.removeEventListener("submit", submit);
      dialog.removeEventListener("cancel", stay);
      token.value = "";
      dialog.close();
      resolve();
    };
    form.addEventListener("submit", submit);
    dialog.addEventListener("cancel", stay);
  });
}
