// What a panel with plots adds to its sheet.
import uplot from "uplot/dist/uPlot.min.css?inline";
import plot from "./plot.css?inline";

export const plotCss = `${uplot}\n${plot}`;
