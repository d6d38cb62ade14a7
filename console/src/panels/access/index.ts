import { define } from "../../element.svelte.js";
import Access from "./Access.svelte";
import css from "./access.css?inline";

define("mom-access", Access, css, ["path", "users", "view"]);
