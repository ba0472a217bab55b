"""From a trained model to C that flies: ONNX, CasADi's C and the streamed kernel in one bundle, proven equal."""
