// Controls without an accessible name, or that cannot be reached by keyboard.
const found = [];
for (const element of document.querySelectorAll("button, a[href], input, canvas, [tabindex], meter")) {
  const name = element.getAttribute("aria-label") ?? element.labels?.[0]?.textContent ?? element.textContent;
  const by = element.getAttribute("aria-labelledby");
  if (!(by ? document.getElementById(by)?.textContent : name)?.trim()) found.push(element.outerHTML.slice(0, 80));
  if (element.tabIndex < 0 && !element.disabled && !element.matches("canvas:not([tabindex]), meter")) found.push(`not reachable by keyboard: ${element.outerHTML.slice(0, 80)}`);
}
return found;
