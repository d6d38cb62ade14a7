import { define } from "../../element.svelte.js";
import dialog from "../../parts/dialog.css?inline";
import free from "../../parts/free.css?inline";
import "../camera/index.js";
import "../token/index.js";
import Fleet from "./Fleet.svelte";
import css from "./fleet.css?inline";

define("mom-fleet", Fleet, dialog + free + css, ["path"]);
