// The pages, each loaded when it is opened; a page is a panel.
export interface Page {
  id: string;
  tag: string;
  load: () => Promise<unknown>;
}

export const pages: readonly Page[] = [
  { id: "drive", tag: "mom-drive", load: () => import("../drive/index.js") },
  { id: "fleet", tag: "mom-fleet", load: () => import("../fleet/index.js") },
  { id: "simulacrum", tag: "mom-simulacrum", load: () => import("../simulacrum/index.js") },
  { id: "modeller", tag: "mom-modeller", load: () => import("../modeller/index.js") },
  { id: "contexts", tag: "mom-contexts", load: () => import("../contexts/index.js") },
  { id: "peers", tag: "mom-peers", load: () => import("../peers/index.js") },
  { id: "access", tag: "mom-access", load: () => import("../access/index.js") },
  { id: "audit", tag: "mom-audit", load: () => import("../audit/index.js") },
  { id: "health", tag: "mom-health", load: () => import("../health/index.js") },
];
