// What runs aside from the page: it makes material when asked, and tells how far it is, what it made and what that is like.
"use strict";

let maker = null;

function answer({ make, porosity }) {
  const began = performance.now(), tell = (done) => postMessage({ done });
  if (make) maker.make(make, tell);
  const labels = maker.labels(porosity), { side, model } = maker, took = performance.now() - began;
  postMessage({ labels, side, took, porosity: porosityOf(labels, model.void), vectors: maker.network.convolver.vectors });
  postMessage({ curve: radialTwoPoint(labels, side, (label) => label !== model.void, Math.min(50, side >> 1)) });
}

self.onmessage = ({ data }) => {
  try {
    if (data.model) maker = new Maker(data.model, data.weights);
    else answer(data);
    postMessage({ idle: true });
  } catch (error) {
    postMessage({ trouble: error.message });
  }
};
