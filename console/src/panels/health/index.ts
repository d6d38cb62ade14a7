import { define } from "../../element.svelte.js";
import { plotCss } from "../../parts/plotcss.js";
import Health from "./Health.svelte";
import css from "./health.css?inline";

define("mom-health", Health, plotCss + css);
