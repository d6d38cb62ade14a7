// Panels are custom elements: a Svelte component in a shadow root, with a sheet of its own.
import { type Component, mount, unmount } from "svelte";
import base from "./look/base.css?inline";
import { type Hub, hubOf } from "./hub/hub.svelte.js";

/** What every panel gets: its element, the hub, and its attributes by name. */
export interface PanelProps {
  host: HTMLElement;
  hub: Hub;
  attributes: { readonly [name: string]: string | undefined };
}

/** Sheets of this kind are let in by a policy that forbids styles in the page. */
function sheet(text: string): CSSStyleSheet {
  const made = new CSSStyleSheet();
  made.replaceSync(text);
  return made;
}

let shared: CSSStyleSheet | undefined;

/** The connection that an element names, or what it stands in: a panel in another one, or a part of the page. */
function connectionOf(element: Element): string {
  let at: Element | null = element;
  while (at) {
    const name = at.getAttribute("connection");
    if (name !== null) return name;
    const root: Node = at.getRootNode();
    at = at.parentElement ?? (root instanceof ShadowRoot ? root.host : null);
  }
  return "";
}

/** Defines a panel; `attributes` are those that it reads. The attribute `connection` names one of several connections. */
export function define(tag: string, panel: Component<PanelProps>, css: string, attributes: readonly string[] = []): void {
  if (customElements.get(tag)) return;
  const own = sheet(css);
  shared ??= sheet(base);
  const sheets = [shared, own];
  customElements.define(
    tag,
    class extends HTMLElement {
      static observedAttributes = [...attributes, "connection"];
      #mounted: Record<string, never> | undefined;
      #attributes: { [name: string]: string | undefined } = $state({});

      connectedCallback(): void {
        const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
        root.adoptedStyleSheets = sheets;
        // Not within the effect of another panel that has put this one into the page: it would take it for its own part, and
        // end it when it runs again.
        queueMicrotask(() => {
          if (this.#mounted || !this.isConnected) return;
          const hub = hubOf(connectionOf(this));
          this.#mounted = mount(panel, { target: root, props: { host: this, hub, attributes: this.#attributes }, context: new Map([["hub", hub]]) });
        });
      }

      disconnectedCallback(): void {
        // One that is moved within the page is connected again at once.
        queueMicrotask(() => {
          if (!this.isConnected) this.#end();
        });
      }

      #end(): void {
        if (this.#mounted) void unmount(this.#mounted);
        this.#mounted = undefined;
      }

      attributeChangedCallback(name: string, before: string | null, value: string | null): void {
        if (name === "connection") {
          if (!this.#mounted || before === value) return;
          this.#end();
          this.connectedCallback();
          return;
        }
        this.#attributes[name] = value ?? undefined;
      }
    },
  );
}
