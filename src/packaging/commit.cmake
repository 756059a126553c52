# Writes the commit that the sources are of, "ea8efec", or "ea8efec-dirty" where files that git knows differ from it; not if OUT says so
# already: cmake -DGIT=git -DSOURCE=DIR -DOUT=FILE -P commit.cmake. Without git, or for sources without their history, there is no OUT.
set(commit "")
if(GIT AND EXISTS ${SOURCE}/.git)
  execute_process(COMMAND ${GIT} describe --always --tags WORKING_DIRECTORY ${SOURCE} OUTPUT_VARIABLE commit
                  OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
endif()
if(commit STREQUAL "")
  file(REMOVE ${OUT})
  return()
endif()
# describe's own --dirty takes the index's lock, which somebody who commits meanwhile would miss.
execute_process(COMMAND ${GIT} --no-optional-locks status --porcelain --untracked-files=no WORKING_DIRECTORY ${SOURCE}
                OUTPUT_VARIABLE changes RESULT_VARIABLE failed ERROR_QUIET)
if(failed OR NOT changes STREQUAL "")
  string(APPEND commit "-dirty")
endif()
set(written "")
if(EXISTS ${OUT})
  file(READ ${OUT} written)
endif()
if(NOT written STREQUAL "${commit}\n")
  file(WRITE ${OUT} "${commit}\n")
endif()
