// Asks for the token when the service requires it. The page stays as it is behind the dialog.

import { login, onUnauthorized } from "./api.js";
import { byId, setText } from "./dom.js";

export function installLogin() {
  let pending = null;
  onUnauthorized(() => {
    pending ??= askForToken().finally(() => {
      pending = null;
    });
    return pending;
  });
}

/** Resolves when the service has accepted a token. */
function askForToken() {
  const [dialog, form, token] = ["login", "login-form", "token"].map(byId);
  setText(byId("login-answer"), "");
  dialog.showModal();
  return new Promise((resolve) => {
    // Without a token the page shows nothing: the dialog stays open.
    const keepOpen = (event) => event.preventDefault();
    const submit = async (event) => {
      event.preventDefault();
      setText(byId("login-answer"), "Logging in …");
      try {
        await login(token.value);
      } catch (error) {
        return setText(byId("login-answer"), error.kind === "unauthorized" ? "Wrong token." : error.message);
      }
      form.removeEventListener("submit", submit);
      dialog.removeEventListener("cancel", keepOpen);
      token.value = "";
      dialog.close();
      resolve();
    };
    form.addEventListener("submit", submit);
    dialog.addEventListener("cancel", keepOpen);
  });
}
