# The Python package, by the interpreter that it was built for; what needs PyTorch is skipped with a word where that is
# missing.
foreach(suite module torch runs door examples package real_to_sim studies)
  add_test(NAME python.${suite} COMMAND ${MIRAGE_PYTHON_PROGRAM} -B ${CMAKE_CURRENT_SOURCE_DIR}/python/test_${suite}.py)
  set_tests_properties(
    python.${suite}
    PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600 COST 100
               ENVIRONMENT "PYTHONPATH=${CMAKE_BINARY_DIR}/python;MIRAGE_BUILD=${CMAKE_BINARY_DIR};MIRAGE_CACHE=${CMAKE_BINARY_DIR}/python-cache;\
MIRAGE_SOURCE=${PROJECT_SOURCE_DIR};OMP_NUM_THREADS=1")
endforeach()
