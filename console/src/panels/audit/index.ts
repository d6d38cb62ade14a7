import { define } from "../../element.svelte.js";
import Audit from "./Audit.svelte";
import css from "./audit.css?inline";

define("mom-audit", Audit, css, ["context", "user", "peer", "what", "verb", "rule", "code", "text", "quick"]);
