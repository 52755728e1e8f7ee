"""How numba compiles a function that only kernels call: lowered once, and optimised as a part of each kernel.

By itself numba optimises a function with all that it calls, and makes machine code of it, before it does the same
with its caller. For a kernel of eighty functions that is half of the time to compile, for code that nobody calls.
"""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# numba and llvmlite ship no stubs.

import ctypes
from typing import Any

from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

# what numba would call from Python: asks an object that is no function to be one, which raises TypeError
_NO_FUNCTION = ctypes.cast(ctypes.pythonapi.PyObject_Call, ctypes.c_void_p).value
# for closures, array expressions and functions that are written out as numba's own statements: kernels have none
_LEFT_OUT = (InlineClosureLikes, InlineOverloads, NopythonRewrites)


class _Part(JITCodeLibrary):
    """The code of one function as lowered; what it calls stays beside it, for the kernel to link."""

    def _optimize_functions(self, ll_module: Any) -> None:
        pass

    def finalize(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def linked(self) -> list[Any]:
        """This library and all that it calls into."""
        return [self, *self._linking_libraries]


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        super().run_pass(state)
        made = state["cr"]
        module, name = made.fndesc.lookup_module(), made.fndesc.qualname
        key = _dynfunc.make_function(module, name, "", _NO_FUNCTION, made.env, (state.library,))
        state.targetctx.insert_user_function(key, made.fndesc, state.library.linked)
        state["cr"] = made._replace(cfunc=key)
        return True


class PartCompiler(CompilerBase):
    """Numba's own passes but for those that do nothing here, and with a lowering that stops before the optimiser."""

    def define_pipelines(self) -> list[PassManager]:
        """The passes, as numba asks for them."""
        passes = PassManager("part")
        for step, description in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if step not in _LEFT_OUT:
                passes.add_pass(_PartLowering if step is NativeLowering else step, description)
        passes.finalize()
        return [passes]
