"use strict";
// Bars between pictures: a bar never passes its neighbour.
for (const swipe of document.querySelectorAll("[data-swipe]")) {
  const bars = [...swipe.querySelectorAll("input")];
  const thumb = 26; // px, as in style.css
  const place = () => bars.forEach((bar, i) => {
    // A range's thumb stays inside its track: its middle runs from half a thumb to half a thumb.
    const width = swipe.clientWidth || 1, share = bar.value / 1000;
    swipe.style.setProperty(`--at${i + 1}`, `${100 * (thumb / 2 + share * (width - thumb)) / width}%`);
  });
  bars.forEach((bar, i) => {
    bar.value = 1000 * (bar.dataset.start ?? (i + 1) / (bars.length + 1));
    bar.addEventListener("input", () => {
      if (i > 0) bar.value = Math.max(bar.value, bars[i - 1].value);
      if (i + 1 < bars.length) bar.value = Math.min(bar.value, bars[i + 1].value);
      place();
    });
  });
  place();
  new ResizeObserver(place).observe(swipe);
}
for (const figure of document.querySelectorAll("data[data-at]"))
  figure.title = `${figure.dataset.at} = ${figure.value}`;
