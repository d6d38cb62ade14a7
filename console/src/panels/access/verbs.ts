// The verbs that managers are asked about (docs/managers.md).
export const VERBS: readonly string[] = [
  "grab", "send", "stop", "unstop", "join", "lookup", "info", "list", "members", "stats", "renew", "give", "accept", "request", "break", "inhibit",
  "invite", "expel", "create", "delete", "audit", "explain", "what-if", "leave", "release", "decline", "uninhibit",
];

export const KINDS: readonly string[] = ["session", "channel", "token"];
