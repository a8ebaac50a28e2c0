"""OpenVINO as an engine."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from mobilestereonet.accelerate.export import example_pair, exportable_form
from mobilestereonet.engines.converted import ConvertedRuntime, Scores
from mobilestereonet.nets import StereoModel

_SIZE = [1, 3, -1, -1]


def to_openvino(net: StereoModel, *, rgb: bool = False, head: bool = True) -> Any:
    """Convert a network to OpenVINO's form in memory.

    Args:
        net: The network, with any weights.
        rgb: See `ExportableNet`.
        head: See `ExportableNet`.

    Returns:
        An ``openvino.Model`` of any height and width, with inputs ``left`` and ``right`` and the
        output ``disparity``.
    """
    import openvino

    model = openvino.convert_model(
        exportable_form(net, rgb=rgb, scores=not head),
        example_input=example_pair(net),
        input=[("left", _SIZE), ("right", _SIZE)],
    )
    model.output(0).tensor.set_names({"disparity"})
    return model


class OpenVINORuntime(ConvertedRuntime):
    """Runs a network in OpenVINO, compiled once for all sizes."""

    name = "openvino"
    extra = "openvino"
    packages = ("openvino",)
    precisions = ("fp32", "bf16")

    def _machine(self) -> object:
        import openvino

        core = openvino.Core()
        facts = ("FULL_DEVICE_NAME", "OPTIMIZATION_CAPABILITIES")
        return [core.get_property("CPU", fact) for fact in facts]

    def _options(self) -> dict[str, Any]:
        # Left to itself OpenVINO computes in bfloat16 wherever the processor can.
        options: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_PRECISION_HINT": {"fp32": "f32", "bf16": "bf16"}[self.precision],
        }
        if self.threads is not None:
            options["INFERENCE_NUM_THREADS"] = self.threads
        return options

    def _convert(self, net: StereoModel) -> bytes:
        import openvino

        compiled = openvino.compile_model(to_openvino(net, head=False), "CPU", self._options())
        blob: bytes = compiled.export_model().getvalue()
        return blob

    def _load(self, model: bytes) -> Scores:
        import openvino

        compiled = openvino.Core().import_model(model, "CPU", self._options())

        def scores(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
            # A request of its own for each call: threads cannot share one.
            result: NDArray[Any] = compiled.create_infer_request().infer([left, right])[0]
            return result

        return scores
