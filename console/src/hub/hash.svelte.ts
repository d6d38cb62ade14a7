// What a page keeps in the address: `#/audit?user=bob&what=refused`, so that it can be linked and comes back after a reload.

const inConsole = (): boolean => document.querySelector("mom-console") !== null;

/** A link to a page of the console: of this one, or of the hub that has given these files to a page of others. */
export function link(page: string, values: { readonly [key: string]: string | undefined }): string {
  const hash = `#/${page}?${query(values)}`;
  return inConsole() ? hash : `${new URL(import.meta.url).origin}/${hash}`;
}

export class Hash {
  #params = $state.raw<URLSearchParams>(new URLSearchParams());
  readonly #start: string;

  /** Of the page of this id; on pages of others, whose address is theirs, nothing is read or written. */
  constructor(page: string) {
    this.#start = `#/${page}`;
    this.#read();
  }

  get isOurs(): boolean {
    return inConsole() && location.hash.split("?")[0] === this.#start;
  }

  #read(): void {
    if (this.isOurs) this.#params = new URLSearchParams(location.hash.slice(this.#start.length + 1));
  }

  /** Follows links to the same page until the function that it gives is called. */
  follow(): () => void {
    const changed = (): void => this.#read();
    window.addEventListener("hashchange", changed);
    return () => window.removeEventListener("hashchange", changed);
  }

  get(key: string): string {
    return this.#params.get(key) ?? "";
  }

  get text(): string {
    return this.#params.toString();
  }

  /** Writes what is not empty. It makes no step in the history: typing is not going anywhere. */
  set(values: { readonly [key: string]: string }): void {
    if (!this.isOurs) return;
    const text = query(values);
    if (text === this.text) return;
    this.#params = new URLSearchParams(text);
    history.replaceState(history.state, "", text ? `${this.#start}?${text}` : this.#start);
  }
}

/** `path=%2Frobot&user=bob`, without what is empty. */
export function query(values: { readonly [key: string]: string | undefined }): string {
  const params = new URLSearchParams();
  for (const [key, value] of Object.entries(values)) if (value) params.set(key, value);
  return params.toString();
}
