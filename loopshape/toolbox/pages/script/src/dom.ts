// Elements in few words.

type Child = Node | string | null;
type Properties = Record<string, string | boolean | number | ((event: never) => void)>;

/** An element: functions become listeners, true a bare attribute, false none. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K, properties: Properties = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") made.addEventListener(name, value as EventListener);
    else if (value !== false) made.setAttribute(name, value === true ? "" : String(value));
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** What has the focus, within the document or the cell that an element stands in. */
export const focusedIn = (element: Node): HTMLElement | null =>
  (element.getRootNode() as Document | ShadowRoot).activeElement as HTMLElement | null;

export function button(text: string, label: string, click: () => void, more: Properties = {}): HTMLButtonElement {
  return el("button", { type: "button", "aria-label": label, title: label, click, ...more }, text);
}

/** Gives a file to the browser to keep. */
export function download(name: string, text: string): void {
  const address = URL.createObjectURL(new Blob([text], { type: "application/toml" }));
  el("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

/** A number as a person reads it: four digits. */
export function shown(value: number): string {
  if (Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replace("-", "−");
}

/** A number as it is written into a field, to six digits. */
export const written = (value: number): string => String(Number(value.toPrecision(6)));

/** What a person typed as a number: a comma is a point. */
export const typed = (text: string): number => (text.trim() === "" ? NaN : Number(text.trim().replace("−", "-").replace(",", ".")));

/** What stands in a field, unless somebody types there. */
export function setField(field: HTMLInputElement, text: string): void {
  if (focusedIn(field) === field) return;
  field.value = text;
  refused(field, null);
}

/** Why the number in a field is not taken, beside it; null where it is. */
function refused(field: HTMLInputElement, why: string | null): void {
  field.setAttribute("aria-invalid", String(why !== null));
  field.parentElement?.querySelector(".why")?.remove();
  if (why === null) return;
  field.after(el("small", { class: "why", role: "alert" }, `${why}.`));
}

/** A field for a number: typed, stepped by arrow keys and the wheel by shares of itself. */
export function numberField(
  label: string, value: number, change: (value: number, goesOn: boolean) => string | null, more: Properties = {},
): HTMLInputElement {
  const field = el("input", { type: "text", inputmode: "decimal", "aria-label": label, value: written(value), autocomplete: "off", ...more });
  const set = (wanted: number, goesOn: boolean): void => {
    const why = change(wanted, goesOn);
    refused(field, why);
    if (why === null && goesOn) field.value = written(wanted);
  };
  const step = (up: boolean, event: KeyboardEvent | WheelEvent, large = false): void => {
    event.preventDefault();
    const share = large || event.shiftKey ? 0.1 : event.altKey ? 0.001 : 0.01;
    const now = typed(field.value) || 0;
    set(now === 0 ? (up ? 0.01 : 0) : now * (up === now > 0 ? 1 + share : 1 / (1 + share)), true);
  };
  field.addEventListener("keydown", (event) => {
    if (event.key === "ArrowUp" || event.key === "ArrowDown") step(event.key === "ArrowUp", event);
    if (event.key === "PageUp" || event.key === "PageDown") step(event.key === "PageUp", event, true);
  });
  field.addEventListener("wheel", (event) => {
    if (focusedIn(field) === field && !field.disabled) step(event.deltaY < 0, event);
  }, { passive: false });
  field.addEventListener("change", () => {
    const value = typed(field.value);
    if (Number.isNaN(value)) refused(field, `${label} must be a number; received ${field.value.trim() || "nothing"}; write digits, as 12.5`);
    else set(value, false);
  });
  return field;
}

/** A slider over a logarithmic scale: `moved` while it is dragged, `ended` when it is let go or a key moved it. */
export function slider(id: string, label: string, low: number, high: number, moved: (value: number) => void, ended: (value: number) => void): { element: HTMLElement; show: (value: number) => void } {
  const words = el("output", { for: id });
  const value = (): number => Number(Math.exp(Number(field.value)).toPrecision(3));
  const say = (text: string): void => {
    words.textContent = text;
    field.setAttribute("aria-valuetext", `${text} Hz`);
  };
  const field = el("input", {
    type: "range", id, min: Math.log(low), max: Math.log(high), step: (Math.log(high / low)) / 400,
    input: () => (say(shown(value())), moved(value())), change: () => ended(value()),
  });
  const show = (now: number): void => {
    if (now > 0) field.value = String(Math.log(now));
    say(now > 0 ? shown(now) : "–");
  };
  return { element: el("p", { class: "row" }, el("label", { for: id }, label), field, words), show };
}
