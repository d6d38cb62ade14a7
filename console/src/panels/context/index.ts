import { define } from "../../element.svelte.js";
import dialog from "../../parts/dialog.css?inline";
import { plotCss } from "../../parts/plotcss.js";
import "../token/index.js";
import Context from "./Context.svelte";
import css from "./context.css?inline";

define("mom-context", Context, plotCss + dialog + css, ["path"]);
